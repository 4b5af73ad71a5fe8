// SPDX-License-Identifier: Apache-2.0
// Bounds a law's stack depth, from the call graph that the compiler wrote.
#pragma once

#include "lawd/core/admission.hpp"
#include "lawd/object/admission_lines.hpp"

namespace lithe::lawd {

void check_stack(const Compiled& compiled, const SourceLines& lines, Admission& out);

}  // namespace lithe::lawd
