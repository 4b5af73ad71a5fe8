// SPDX-License-Identifier: Apache-2.0
// Carries the state of one law into the next: a bounded list of copies, planned off the tick, applied inside it.
// A field that holds no usable number is not carried.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "lithe/law.hpp"
#include "spine/core/rt.hpp"

namespace lithe::law {

// One field that both laws have. When the types differ, each element is converted without loss.
struct Copy {
  std::uint32_t from, to;            // offsets
  std::uint32_t count;               // elements
  std::uint32_t field;               // its index in the target State
  std::uint16_t from_kind, to_kind;  // FieldKind
};

struct Migration {
  std::uint32_t count = 0;
  std::array<Copy, kMaxStateFields> copies{};
};

// A field is carried when its name is the same (so the unit in it, too) and its type is the same or wider: more
// elements, of which the others keep what they have, or an element type that holds every value of the old one. All
// other fields of `to` keep what they have. Both descriptors must have passed check_law.
// Contract: off the tick; allocates nothing.
Migration plan_migration(const LitheLaw& from, const LitheLaw& to);

// True when `to` holds every value of `from`. bool goes to bool only.
bool widens(FieldKind from, FieldKind to);

// The largest magnitude of a float or double that is carried. Above every count of nanoseconds since the machine
// started (2^63 is 9.2e18), which a law may keep as a double; below the root of the largest float (1.8e19), so that the
// square of a carried value is finite.
inline constexpr double kMostCarried = 1e18;

// One bit per field of a State, by its index.
using FieldBits = std::uint32_t;
static_assert(kMaxStateFields <= 32);

// Copies all fields but those of which an element is NaN, infinite or beyond kMostCarried: `to` keeps what it has
// there. Returns the fields of `to` that were left out.
// Contract: RT · at most kMaxStateFields copies of at most kMaxStateBytes in all.
FieldBits apply_migration(const Migration& plan, const std::byte* from, std::byte* to) LITHE_RT;

// Puts fields of a law's own State that hold such a value back to their default, unless the default is such a value
// itself (a law may mark with NaN what it does not know yet). Returns those fields. `law` must have passed check_law.
// Contract: RT · bounded by kMaxStateBytes.
FieldBits mend_state(const LitheLaw& law, std::byte* state) LITHE_RT;

}  // namespace lithe::law
