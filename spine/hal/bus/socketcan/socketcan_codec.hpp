// SPDX-License-Identifier: Apache-2.0
// The packets of a raw CAN socket of Linux: struct can_frame (16 bytes) and struct canfd_frame (72 bytes). Pure.
#pragma once

#include <linux/can.h>

#include <cstddef>
#include <cstdint>
#include <span>

#include "spine/core/rt.hpp"
#include "spine/hal/core/frame.hpp"

namespace lithe::hal::socketcan {

// Counts of error frames that tell these two.
struct ErrorCounts {
  std::uint64_t bus_off = 0;    // silent until the restart
  std::uint64_t restarted = 0;  // after bus-off
};

// The number of bytes in `out`; 0: not a valid CAN frame.
std::size_t encode(const Frame& frame, canfd_frame& out) LITHE_RT;

enum class Kind : std::uint8_t {
  frame,
  remote,     // remote frame; not used by the devices here
  error,      // counted in `error_counts`
  malformed,  // not a valid packet
};

// Parses one packet. `frame` is changed by Kind::frame only, `error_counts` by Kind::error only.
Kind decode(std::span<const std::byte> bytes, Frame& frame, ErrorCounts& error_counts) LITHE_RT;

}  // namespace lithe::hal::socketcan
