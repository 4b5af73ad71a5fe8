// SPDX-License-Identifier: Apache-2.0
// Keys of a [[device]] that only a CiA 402 drive has.
#pragma once

#include <cstdint>

#include "spine/robot/read/joint_demand.hpp"

namespace lithe::hal::cia402 {

enum class Mode : std::int8_t { none = 0, position = 8, velocity = 9, torque = 10 };  // the cyclic synchronous ones

struct Keys {
  Mode mode = Mode::torque;      // type of its setpoint
  double counts_per_rev = 4096;  // of the motor's position
  double rated_torque_nm = 1.0;  // of the motor: object 6076h, of which torques are thousandths
};

void read_keys(robot::Reader& in, Keys& keys, robot::Need need);
void check_joint(robot::Reader& in, const Keys& keys, const robot::JointDemand& joint);

}  // namespace lithe::hal::cia402
