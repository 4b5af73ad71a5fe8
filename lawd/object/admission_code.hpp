// SPDX-License-Identifier: Apache-2.0
// Checks the instructions of a law. Refused: those that enter the kernel, switch the containment off, or give a
// different result on each call.
#pragma once

#include <string_view>

#include "lawd/core/admission.hpp"
#include "lawd/object/admission_lines.hpp"

namespace lithe::lawd {

void check_code(const Compiled& compiled, const SourceLines& lines, Admission& out);

// Why a law may not have an instruction (as objdump names it); empty when it may.
std::string_view why_instruction_is_refused(std::string_view mnemonic);

}  // namespace lithe::lawd
