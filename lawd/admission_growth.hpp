// SPDX-License-Identifier: Apache-2.0
// How many words a law's own macros make of its text: a few lines of them can fill a machine's memory.
#pragma once

#include <cstddef>
#include <string_view>

#include "lawd/admission.hpp"
#include "lawd/admission_tokens.hpp"

namespace lithe::lawd {

// Refuses, in the name of `gate`, a text that grows to more than `most_words`, and macros whose growth has no bound
// that can be told beforehand. Nothing is expanded.
// Contract: any tokens are safe · linear in their number
void check_growth(const Tokens& tokens, std::size_t most_words, const char* gate, Admission& out);

}  // namespace lithe::lawd
