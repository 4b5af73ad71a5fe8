// SPDX-License-Identifier: Apache-2.0
// Takes off what language models and web pages put around a law: prose, Markdown code fences, HTML escapes,
// typographic characters.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "lawd/core/admission.hpp"

namespace lithe::lawd {

struct Cleaned {
  std::string text;                // as many lines as were sent: a line that was taken off is empty
  std::vector<std::string> notes;  // what was taken off or replaced, one sentence each; empty = the text is as sent
};

// Of several code blocks the one with LITHE_LAW is taken; when none or more than one has it, `out` refuses (gate
// "text") and the text is as sent. Whatever could be C++ stays, for admission and the compiler.
// Contract: any bytes are safe · linear in the size of `sent`
Cleaned clean_source(std::string_view sent, Admission& out);

}  // namespace lithe::lawd
