// SPDX-License-Identifier: Apache-2.0
// Process data objects (PDO): values packed into 8 bytes by a mapping that both sides know. Pure.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <span>

#include "spine/core/rt.hpp"
#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/canopen/canopen_sdo.hpp"
#include "spine/hal/core/frame.hpp"

namespace lithe::hal::canopen {

// One object of a PDO; whole bytes only (1, 2 or 4).
struct Mapped {
  Address address;
  std::uint8_t bytes = 0;

  // As objects 1600h and 1A00h hold it: index << 16 | subindex << 8 | bits.
  constexpr std::uint32_t entry() const LITHE_RT {
    return std::uint32_t{address.index} << 16 | std::uint32_t{address.subindex} << 8 | bytes * 8U;
  }
};

// Contract: RT · a value
class PdoMap {
 public:
  static constexpr std::size_t kMost = 8;  // objects in one PDO

  constexpr PdoMap() = default;
  // At most 8 objects of at most 8 bytes.
  constexpr PdoMap(std::initializer_list<Mapped> objects) {
    for (const Mapped& object : objects) add(object);
  }

  // False: no room; the map is unchanged.
  constexpr bool add(const Mapped& object) LITHE_RT {
    if (count_ == kMost || bytes_ + object.bytes > 8) return false;
    objects_[count_++] = object;
    bytes_ += object.bytes;
    return true;
  }

  constexpr std::span<const Mapped> objects() const LITHE_RT { return {objects_.data(), count_}; }
  constexpr std::size_t bytes() const LITHE_RT { return bytes_; }

  // Values in the order of the objects; missing ones are 0. Only the lowest bytes of each are used.
  Frame pack(std::uint32_t id, std::span<const std::uint32_t> values) const LITHE_RT {
    Frame frame = blank(id, bytes_);
    std::size_t at = 0;
    for (std::size_t i = 0; i < count_; ++i) {
      if (i < values.size()) put_little_endian(frame.data.data() + at, values[i], objects_[i].bytes);
      at += objects_[i].bytes;
    }
    return frame;
  }
  // False when the frame is shorter than the map; extra bytes are ignored. At least objects().size() values; signed
  // values are not sign-extended (see signed_of).
  bool unpack(const Frame& frame, std::span<std::uint32_t> values) const LITHE_RT {
    if (!is_canopen(frame) || frame.size < bytes_) return false;
    std::size_t at = 0;
    for (std::size_t i = 0; i < std::min(count_, values.size()); ++i) {
      values[i] = little_endian(frame.data.data() + at, objects_[i].bytes);
      at += objects_[i].bytes;
    }
    return true;
  }

 private:
  std::array<Mapped, kMost> objects_{};
  std::size_t count_ = 0;
  std::size_t bytes_ = 0;
};

// Sign-extends a value.
constexpr std::int32_t signed_of(std::uint32_t raw, std::size_t bytes) LITHE_RT {
  if (bytes == 1) return static_cast<std::int8_t>(raw);
  return bytes == 2 ? static_cast<std::int16_t>(raw) : static_cast<std::int32_t>(raw);
}

}  // namespace lithe::hal::canopen
