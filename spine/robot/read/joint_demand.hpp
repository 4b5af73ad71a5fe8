// SPDX-License-Identifier: Apache-2.0
// What a joint needs of its drive: the keys of a kind of drive are checked with it.
#pragma once

#include <string_view>

namespace lithe::robot {

class Reader;     // in reader.hpp
enum class Need;  // in reader.hpp

// At the motor, behind the gear.
struct JointDemand {
  std::string_view device;     // the drive's name
  double farthest_rev = 0;     // from where the drive reads 0, within the joint's limits
  double fault_rev = 0;        // the same, up to where the robot stops with a fault
  double fault_rev_s = 0;      // the speed at which the robot stops with a fault
  double torque_nm = 0;        // the largest
  bool power_limited = false;  // the joint has a power limit
};

}  // namespace lithe::robot
