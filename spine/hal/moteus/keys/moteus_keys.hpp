// SPDX-License-Identifier: Apache-2.0
// Keys of a [[device]] that only a moteus has.
#pragma once

#include <optional>

#include "spine/hal/moteus/keys/moteus_units.hpp"
#include "spine/robot/read/joint_demand.hpp"

namespace lithe::hal::moteus {

// [device.frames]: formats of the numbers in its frames. Fewer bytes make shorter frames and coarser numbers.
struct FrameKeys {
  Format command = Format::float32;  // all numbers of a command but its settings
  Format answer = Format::float32;   // position, velocity, torque
  std::optional<Format> current{};   // none: it is not asked for
  std::optional<Format> power{};
  bool settings_in_drive = false;  // watchdog, planner and integral as the drive is configured, not in every command
};

struct Keys {
  FrameKeys frames{};
  bool may_hold_alone = false;  // when this computer dies it may hold its joint, with no limit from LITHE
};

void read_keys(robot::Reader& in, Keys& keys);
void read_frames(robot::Reader& in, FrameKeys& frames);
// Error when a number of the joint is beyond its format, where it would be clipped.
void check_joint(robot::Reader& in, const Keys& keys, const robot::JointDemand& joint);

}  // namespace lithe::hal::moteus
