// SPDX-License-Identifier: Apache-2.0
// Carries the state of one law into the next: a bounded list of copies, planned off the tick, applied inside it.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "lithe/law.hpp"
#include "spine/core/rt.hpp"

namespace lithe::law {

// One run of bytes that means the same in both laws.
struct Copy {
  std::uint32_t from, to, bytes;
};

struct Migration {
  std::uint32_t count = 0;
  std::uint32_t bytes = 0;  // sum over all copies
  std::array<Copy, kMaxStateFields> copies{};
};

// A field is carried when its name, its element type and its element count are the same. All other fields of `to` keep
// what they have. Both descriptors must have passed check_law. Contract: off the tick; allocates nothing.
Migration plan_migration(const LitheLaw& from, const LitheLaw& to);

// Contract: RT · at most kMaxStateFields copies of at most kMaxStateBytes in all.
void apply_migration(const Migration& plan, const std::byte* from, std::byte* to) LITHE_RT;

}  // namespace lithe::law
