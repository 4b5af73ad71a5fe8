// SPDX-License-Identifier: Apache-2.0
#include "spine/core/serialise.hpp"

#include <gtest/gtest.h>

#include <array>
#include <numeric>

namespace lithe {
namespace {

// Keeps values on the stack, below its pointer as well (the red zone of a function that calls nothing).
__attribute__((noinline)) std::uint64_t sum_across(const std::array<std::uint64_t, 16>& values) {
  std::array<volatile std::uint64_t, 16> kept;
  for (std::size_t i = 0; i < values.size(); ++i) kept[i] = values[i];
  serialise_core();
  std::uint64_t sum = 0;
  for (const auto& value : kept) sum += value;
  return sum;
}

TEST(Serialise, LeavesRegistersStackAndFlagsAsTheyWere) {
  std::array<std::uint64_t, 16> values;
  std::iota(values.begin(), values.end(), 1);
  double real = 0.5;
  for (int i = 0; i < 1000; ++i) {
    EXPECT_EQ(sum_across(values), 136u);
    const bool odd = (i & 1) != 0;
    serialise_core();
    EXPECT_EQ(odd, i % 2 == 1);
    real = real * 0.5 + 0.25;
  }
  EXPECT_EQ(real, 0.5);
}

}  // namespace
}  // namespace lithe
