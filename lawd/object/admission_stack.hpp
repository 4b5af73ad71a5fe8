// SPDX-License-Identifier: Apache-2.0
// How deep a law's stack can become, from the call graph that the compiler wrote beside the object.
#pragma once

#include "lawd/core/admission.hpp"
#include "lawd/object/admission_lines.hpp"

namespace lithe::lawd {

void check_stack(const Compiled& compiled, const SourceLines& lines, Admission& out);

}  // namespace lithe::lawd
