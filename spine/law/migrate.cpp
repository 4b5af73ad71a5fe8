// SPDX-License-Identifier: Apache-2.0
#include "spine/law/migrate.hpp"

#include <cmath>
#include <cstring>
#include <limits>

namespace lithe::law {
namespace {

// What f gives for a value of the kind's type; {} for kinds that are carried as they are or not at all.
template <class F>
auto with_type(FieldKind kind, F f) LITHE_RT {
  switch (kind) {
    case FieldKind::i8:
      return f(std::int8_t{});
    case FieldKind::u8:
      return f(std::uint8_t{});
    case FieldKind::i16:
      return f(std::int16_t{});
    case FieldKind::u16:
      return f(std::uint16_t{});
    case FieldKind::i32:
      return f(std::int32_t{});
    case FieldKind::u32:
      return f(std::uint32_t{});
    case FieldKind::i64:
      return f(std::int64_t{});
    case FieldKind::u64:
      return f(std::uint64_t{});
    case FieldKind::f32:
      return f(float{});
    case FieldKind::f64:
      return f(double{});
    case FieldKind::boolean:
    case FieldKind::none:
      break;
  }
  return decltype(f(double{})){};
}

struct Shape {
  int bits = 0;  // number of bits it holds exactly: 53 for a double
  bool is_signed = false, is_float = false;
};

Shape shape(FieldKind kind) {
  return with_type(kind, [](auto value) LITHE_RT {
    using Limits = std::numeric_limits<decltype(value)>;
    return Shape{Limits::digits, Limits::is_signed, !Limits::is_integer};
  });
}

template <class T>
bool usable_as(const std::byte* at, std::uint32_t count) LITHE_RT {
  bool usable = true;
  for (std::uint32_t k = 0; k < count && k < kMaxStateBytes; ++k) {
    T value;
    std::memcpy(&value, at + k * sizeof value, sizeof value);
    usable &= std::abs(static_cast<double>(value)) <= kMostCarried;  // false for NaN
  }
  return usable;
}

// True when all `count` elements are usable: finite and not too large. Every integer is.
bool usable(const std::byte* at, FieldKind kind, std::uint32_t count) LITHE_RT {
  if (kind == FieldKind::f64) return usable_as<double>(at, count);
  if (kind == FieldKind::f32) return usable_as<float>(at, count);
  return true;
}

bool carried(const LitheStateField& from, const LitheStateField& to) {
  return from.count <= to.count && widens(FieldKind{from.kind}, FieldKind{to.kind}) &&
         std::strncmp(from.name, to.name, sizeof from.name) == 0;
}

void convert(const std::byte* from, FieldKind from_kind, std::byte* to, FieldKind to_kind) LITHE_RT {
  with_type(from_kind, [&](auto value) LITHE_RT {
    std::memcpy(&value, from, sizeof value);
    return with_type(to_kind, [&](auto wider) LITHE_RT {
      wider = static_cast<decltype(wider)>(value);  // NOLINT(bugprone-signed-char-misuse): it widens a number
      std::memcpy(to, &wider, sizeof wider);
      return true;
    });
  });
}

}  // namespace

bool widens(FieldKind from, FieldKind to) {
  if (from == to) return from != FieldKind::none;
  const Shape a = shape(from), b = shape(to);
  if (a.bits == 0 || b.bits == 0 || (a.is_signed && !b.is_signed) || (a.is_float && !b.is_float)) return false;
  return a.bits < b.bits || (a.bits == b.bits && a.is_signed == b.is_signed);
}

Migration plan_migration(const LitheLaw& from, const LitheLaw& to) {
  Migration plan;
  for (std::uint32_t i = 0; i < to.state_count; ++i) {
    for (std::uint32_t k = 0; k < from.state_count; ++k) {
      const LitheStateField &old = from.state[k], &now = to.state[i];
      if (!carried(old, now)) continue;
      plan.copies[plan.count++] = {old.offset,
                                   now.offset,
                                   old.count,
                                   i,
                                   static_cast<std::uint16_t>(old.kind),
                                   static_cast<std::uint16_t>(now.kind)};
      break;
    }
  }
  return plan;
}

FieldBits apply_migration(const Migration& plan, const std::byte* from, std::byte* to) LITHE_RT {
  FieldBits left_out = 0;
  for (std::uint32_t i = 0; i < plan.count && i < plan.copies.size(); ++i) {
    const Copy& copy = plan.copies[i];
    const FieldKind from_kind{copy.from_kind}, to_kind{copy.to_kind};
    const std::uint32_t from_bytes = kind_bytes(from_kind), to_bytes = kind_bytes(to_kind);
    if (!usable(from + copy.from, from_kind, copy.count)) {
      left_out |= FieldBits{1} << (copy.field % kMaxStateFields);
      continue;
    }
    if (from_kind == to_kind) {
      std::memcpy(to + copy.to, from + copy.from, std::size_t{copy.count} * from_bytes);
      continue;
    }
    for (std::uint32_t k = 0; k < copy.count && k < kMaxStateBytes; ++k)
      convert(from + copy.from + k * from_bytes, from_kind, to + copy.to + k * to_bytes, to_kind);
  }
  return left_out;
}

FieldBits mend_state(const LitheLaw& law, std::byte* state) LITHE_RT {
  FieldBits mended = 0;
  const auto* defaults = static_cast<const std::byte*>(law.state_defaults);
  for (std::uint32_t i = 0; i < law.state_count && i < kMaxStateFields; ++i) {
    const LitheStateField& field = law.state[i];
    const FieldKind kind{field.kind};
    const std::size_t bytes = std::size_t{field.count} * kind_bytes(kind);
    if (field.offset + bytes > kMaxStateBytes || usable(state + field.offset, kind, field.count)) continue;
    if (!usable(defaults + field.offset, kind, field.count)) continue;
    std::memcpy(state + field.offset, defaults + field.offset, bytes);
    mended |= FieldBits{1} << i;
  }
  return mended;
}

}  // namespace lithe::law
