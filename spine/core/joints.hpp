// SPDX-License-Identifier: Apache-2.0
// Maximum number of joints, and the array type of every joint quantity.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>

#include "spine/core/rt.hpp"

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

// The first `joints` entries.
inline void copy_joints(const JointArray& from, JointArray& to, std::size_t joints) LITHE_RT {
  std::copy_n(from.begin(), joints, to.begin());
}
inline bool all_finite(const JointArray& values, std::size_t joints) LITHE_RT {
  double sum = 0;  // x - x is 0 for every finite x and NaN for all others
  for (std::size_t j = 0; j < joints; ++j) sum += values[j] - values[j];
  return sum == 0;
}

}  // namespace lithe
