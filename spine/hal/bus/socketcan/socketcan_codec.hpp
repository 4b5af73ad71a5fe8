// SPDX-License-Identifier: Apache-2.0
// What goes through a raw CAN socket of Linux: struct can_frame (16 bytes) and struct canfd_frame (72 bytes). Pure.
#pragma once

#include <linux/can.h>

#include <cstddef>
#include <cstdint>
#include <span>

#include "spine/core/rt.hpp"
#include "spine/hal/core/frame.hpp"

namespace lithe::hal::socketcan {

// What error frames have told about a bus. One frame may tell several things.
struct Troubles {
  std::uint64_t bus_off = 0;         // the controller gave up; it says nothing until it is restarted
  std::uint64_t restarted = 0;       // and it was
  std::uint64_t passive = 0;         // 128 errors and more
  std::uint64_t warning = 0;         // 96 errors and more
  std::uint64_t unacknowledged = 0;  // sent, and no other node was there to hear it
  std::uint64_t arbitration = 0;     // lost, where the controller tells
  std::uint64_t overflow = 0;        // frames the controller had no room for
  std::uint64_t violations = 0;      // of the protocol: stuffing, form, bits, checksums
  std::uint64_t timeouts = 0;        // of the transmitter
  std::uint64_t transceiver = 0;     // a broken wire, a missing supply
};

// The bytes of `out` that carry the frame; 0: CAN has no such frame.
std::size_t encode(const Frame& frame, canfd_frame& out) LITHE_RT;

enum class Kind : std::uint8_t {
  frame,
  remote,     // carries nothing; no device here asks so
  error,      // counted in `troubles`
  malformed,  // no frame of the kernel's
};

// What one read brought. `frame` is changed by Kind::frame only, `troubles` by Kind::error only.
Kind decode(std::span<const std::byte> bytes, Frame& frame, Troubles& troubles) LITHE_RT;

}  // namespace lithe::hal::socketcan
