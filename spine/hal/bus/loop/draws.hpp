// SPDX-License-Identifier: Apache-2.0
// Random numbers of what is simulated.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"

namespace lithe::hal::sim {

// Independent uniform 64-bit numbers, the same for the same seed (SplitMix64).
class Draws {
 public:
  explicit Draws(std::uint64_t seed) : state_(seed) {}

  std::uint64_t next() LITHE_RT {
    std::uint64_t z = state_ += 0x9e3779b97f4a7c15;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9;
    z = (z ^ (z >> 27)) * 0x94d049bb133111eb;
    return z ^ (z >> 31);
  }
  // In [0, 1).
  double share() LITHE_RT { return static_cast<double>(next() >> 11) * 0x1p-53; }
  // In [-1, 1).
  double signed_share() LITHE_RT { return 2 * share() - 1; }
  // Mean 0, standard deviation 1, never beyond 3.47: the sum of four uniform numbers. No call into the C library, so
  // that the same bits come out everywhere.
  double normal() LITHE_RT {
    constexpr double kMean = 2 * 65535.0, kDeviation = 37837.2275;  // of the sum of four numbers from 0 to 65535
    const std::uint64_t z = next();
    const auto sum = static_cast<double>((z & 0xffff) + (z >> 16 & 0xffff) + (z >> 32 & 0xffff) + (z >> 48 & 0xffff));
    return (sum - kMean) / kDeviation;
  }

 private:
  std::uint64_t state_;
};

}  // namespace lithe::hal::sim
