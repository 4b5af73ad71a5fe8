// SPDX-License-Identifier: Apache-2.0
// One CAN or CAN FD frame.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "spine/core/rt.hpp"

namespace lithe::hal {

inline constexpr std::size_t kMaxPayload = 64;

struct Frame {
  std::uint32_t id = 0;   // 11 bits, or 29 when extended
  std::uint8_t size = 0;  // bytes of data: 0 to 8, 12, 16, 20, 24, 32, 48 or 64
  bool extended = false;
  bool fd = false;
  bool brs = false;  // data phase at the higher bit rate
  std::array<std::uint8_t, kMaxPayload> data{};

  // The valid bytes, also when `size` is wrong.
  std::span<const std::uint8_t> payload() const LITHE_RT {
    return {data.data(), size < kMaxPayload ? size : kMaxPayload};
  }
};

// The smallest length CAN-FD can carry that holds `size` bytes (size <= 64).
constexpr std::size_t fd_size(std::size_t size) LITHE_RT {
  if (size <= 8) return size;
  if (size <= 24) return (size + 3) / 4 * 4;
  if (size <= 32) return 32;
  return size <= 48 ? 48 : 64;
}

// Little-endian numbers of 1 to 4 bytes.
constexpr void put_little_endian(std::uint8_t* out, std::uint32_t value, std::size_t bytes) LITHE_RT {
  for (std::size_t i = 0; i < bytes; ++i) out[i] = static_cast<std::uint8_t>(value >> (8 * i));
}
constexpr std::uint32_t little_endian(const std::uint8_t* in, std::size_t bytes) LITHE_RT {
  std::uint32_t value = 0;
  for (std::size_t i = 0; i < bytes; ++i) value |= std::uint32_t{in[i]} << (8 * i);
  return value;
}

inline constexpr std::uint32_t kLargestStandardId = 0x7ff;
inline constexpr std::uint32_t kLargestId = 0x1fff'ffff;

// True for a valid CAN frame: id in range, existing length, more than 8 bytes and bit rate switching only with FD.
constexpr bool is_can(const Frame& frame) LITHE_RT {
  if (frame.id > (frame.extended ? kLargestId : kLargestStandardId)) return false;
  if (!frame.fd && (frame.brs || frame.size > 8)) return false;
  return frame.size <= kMaxPayload && fd_size(frame.size) == frame.size;
}

}  // namespace lithe::hal
