// SPDX-License-Identifier: Apache-2.0
// Maximum number of joints, and the array type of every joint quantity.
#pragma once

#include <array>
#include <cstddef>

#ifndef LITHE_NJ
#define LITHE_NJ 32
#endif

namespace lithe {

// The law contract (lithe/law.hpp) stands alone and repeats these two; whichever comes first defines them.
#ifndef LITHE_JOINTS_DEFINED
#define LITHE_JOINTS_DEFINED
// Capacity in joints, a build option (`-DLITHE_NJ=`). A robot uses the first `joints` entries of every array.
inline constexpr std::size_t kMaxJoints = LITHE_NJ;

using JointArray = std::array<double, kMaxJoints>;
#endif

}  // namespace lithe
