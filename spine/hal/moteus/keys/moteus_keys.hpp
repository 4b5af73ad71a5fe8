// SPDX-License-Identifier: Apache-2.0
// Keys of a [[device]] that only a moteus has, and the formats of the numbers in its frames: the unit of one count and
// the range of each.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>

#include "spine/core/rt.hpp"
#include "spine/robot/read/joint_demand.hpp"

namespace lithe::hal::moteus {

enum class Format : std::uint8_t { int8, int16, int32, float32 };

// Kind of quantity: decides the unit of one count of an integer format. Angles in revolutions, as in the drive.
enum class Quantity : std::uint8_t {
  integer,
  position_rev,
  velocity_rev_s,
  acceleration_rev_s2,
  torque_nm,
  fraction,  // PWM duty and gain scales: 1 is the largest integer
  voltage_v,
  temperature_c,
  current_a,
  time_s,
  power_w,
};

// One count of int8, int16, int32, by Quantity.
inline constexpr double kWorth[][3] = {
    {1, 1, 1},                                   // integer
    {0.01, 0.0001, 0.00001},                     // position
    {0.1, 0.00025, 0.00001},                     // velocity
    {0.05, 0.001, 0.00001},                      // acceleration
    {0.5, 0.01, 0.001},                          // torque
    {1.0 / 127, 1.0 / 32767, 1.0 / 2147483647},  // fraction
    {0.5, 0.1, 0.001},                           // voltage
    {1, 0.1, 0.001},                             // temperature
    {1, 0.1, 0.001},                             // current
    {0.01, 0.001, 0.000001},                     // time
    {10, 0.05, 0.0001},                          // power
};

// Unit of one count; 1 for float.
constexpr double count_worth(Quantity quantity, Format format) LITHE_RT {
  if (format == Format::float32) return 1;
  return kWorth[static_cast<std::size_t>(quantity)][static_cast<std::size_t>(format)];
}

// The largest value of the format; infinite for float.
constexpr double largest(Quantity quantity, Format format) LITHE_RT {
  constexpr double kCounts[] = {127, 32767, 2147483647, std::numeric_limits<double>::infinity()};
  return kCounts[static_cast<std::size_t>(format)] * count_worth(quantity, format);
}

// [device.frames]: formats of the numbers in its frames. Fewer bytes make shorter frames and coarser numbers: int16 has
// positions in steps of 1e-4 turns up to 3.27 turns, int8 in steps of 0.01 up to 1.27; torque in steps of 0.01 and 0.5
// Nm. Supply voltage and temperature are always asked for (no extra bytes).
struct FrameKeys {
  Format command = Format::float32;  // all numbers of a command but its settings; integer gain scales end at 1
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
