// SPDX-License-Identifier: Apache-2.0
#include "spine/core/serialise.hpp"

#include <gtest/gtest.h>

#if defined(__x86_64__)
#include <x86intrin.h>
#endif

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

TEST(Serialise, LeavesTheStackAsItWas) {
  std::array<std::uint64_t, 16> values;
  std::iota(values.begin(), values.end(), 1);
  for (int i = 0; i < 1000; ++i) EXPECT_EQ(sum_across(values), 136u);
}

#if defined(__x86_64__)
TEST(Serialise, LeavesTheFlagsAsTheyWere) {
  constexpr std::uint64_t kDirection = 1u << 10, kAlignment = 1u << 18;
  const std::uint64_t before = __builtin_ia32_readeflags_u64();
  __builtin_ia32_writeeflags_u64(before | kDirection | kAlignment);
  serialise_core();
  const std::uint64_t after = __builtin_ia32_readeflags_u64();
  __builtin_ia32_writeeflags_u64(before);
  EXPECT_EQ(after & (kDirection | kAlignment), kDirection | kAlignment);
}
#endif

}  // namespace
}  // namespace lithe
