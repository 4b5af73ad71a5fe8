// SPDX-License-Identifier: Apache-2.0
// What a device or a bus's master sends, for planning a bus.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace lithe::hal {

// Frames of one kind. Its identifier is id + i * id_step modulo id_wrap for the i-th of them: that of a moteus changes
// with every exchange.
struct PlannedFrame {
  const char* what;      // "command", "answer", "SYNC" ...
  std::size_t size = 0;  // bytes of data as on the wire
  std::uint32_t id = 0;
  bool fd = false;
  bool outbound = false;  // from the robot's computer to a device
  double per_tick = 0;    // frames, with the device's rate divider
  double per_s = 0;       // those that go by the clock instead
  bool unasked = false;   // sent by the device's own clock
  bool on_bus = true;     // false: on its board only
  std::uint32_t id_step = 0;
  std::uint32_t id_wrap = 1;

  constexpr std::uint32_t id_of(std::uint32_t number) const { return id + number * id_step % id_wrap; }
};

using PlannedFrames = std::vector<PlannedFrame>;

}  // namespace lithe::hal
