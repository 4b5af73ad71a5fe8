// SPDX-License-Identifier: Apache-2.0
// Bounds the size of a law after macro expansion: a few lines of macros can expand to more than the memory.
#pragma once

#include <cstddef>
#include <string_view>

#include "lawd/core/admission.hpp"
#include "lawd/source/admission_tokens.hpp"

namespace lithe::lawd {

// Refuses, as gate `gate`, a text that would expand to more than `most_words` words, and macros whose expansion cannot
// be bounded. Nothing is expanded here.
// Contract: any tokens are safe · linear in their number
void check_growth(const Tokens& tokens, std::size_t most_words, const char* gate, Admission& out);

}  // namespace lithe::lawd
