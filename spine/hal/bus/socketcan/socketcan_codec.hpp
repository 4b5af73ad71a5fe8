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

// The number of bytes in `out`; 0: not a valid CAN frame.
std::size_t encode(const Frame& frame, canfd_frame& out) LITHE_RT;

enum class Kind : std::uint8_t {
  frame,
  remote,     // remote frame; not used by the devices here
  error,      // an error frame that tells neither of the next two
  bus_off,    // silent until the restart
  restarted,  // after bus-off
  malformed,  // not a valid packet
};

// Parses one packet. `frame` is changed by Kind::frame only.
Kind decode(std::span<const std::byte> bytes, Frame& frame) LITHE_RT;

}  // namespace lithe::hal::socketcan
