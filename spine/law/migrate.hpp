// SPDX-License-Identifier: Apache-2.0
// Carries the state of one law into the next: a bounded list of copies, planned off the tick, applied inside it.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "lithe/law.hpp"
#include "spine/core/rt.hpp"

namespace lithe::law {

// One field that means the same in both laws. With kinds that differ each element is converted, without loss.
struct Copy {
  std::uint32_t from, to;            // offsets
  std::uint32_t count;               // elements
  std::uint16_t from_kind, to_kind;  // FieldKind
};

struct Migration {
  std::uint32_t count = 0;
  std::uint32_t bytes = 0;  // written, over all copies
  std::array<Copy, kMaxStateFields> copies{};
};

// A field is carried when its name is the same (so the unit in it, too) and its type is the same or wider: more
// elements, of which the others keep what they have, or an element type that holds every value of the old one. All
// other fields of `to` keep what they have. Both descriptors must have passed check_law.
// Contract: off the tick; allocates nothing.
Migration plan_migration(const LitheLaw& from, const LitheLaw& to);

// Whether every value of `from` is one of `to`. bool goes to bool only.
bool widens(FieldKind from, FieldKind to);

// Contract: RT · at most kMaxStateFields copies of at most kMaxStateBytes in all.
void apply_migration(const Migration& plan, const std::byte* from, std::byte* to) LITHE_RT;

}  // namespace lithe::law
