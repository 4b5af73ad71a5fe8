// SPDX-License-Identifier: Apache-2.0
// The robot of the fault matrix, its devices at wires that can be spoilt, and what a fault does to it, told in words.
// Every part is the one a real robot has, from frames to the tick; only time is virtual.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "sim/devices.hpp"
#include "spine/loop/test/tick_rig.hpp"

namespace lithe::faults {

// One cell of the matrix: what is done to which kind of device, and how the robot is made.
struct Cell {
  std::string order;  // as `lithe sim` takes it, with "bus" or "device" left out; empty: the host stalls
  std::string kind;   // moteus, cia402, gateway
  bool before_arming = false;
  bool others_stop = false;  // [guard] other_groups
};

// What became of it. A ladder is the rungs in the order in which they were reached: "safe_law brake off".
struct Outcome {
  std::string armed;  // what `arm` was answered with the fault there, in the cells before arming
  std::string fault;  // latched for the robot, and of the joint
  std::string joint_fault;
  std::string ladder;      // of the joint whose device it was; "law" when nothing happened
  std::string group;       // of the other joint of its group
  std::string others;      // of the joints of the other groups; "?" when they differ
  int ticks = 0;           // from the fault to the first rung
  std::string counted;     // the reply counters that rose, in alphabetical order
  std::string named;       // the event that names fault, joint and group; empty when there was none
  std::string sensor;      // at the end of the fault
  bool latched = true;     // nothing was undone when the fault was over
  bool recovered = false;  // reset and arm brought the law back
  std::string broken;      // the first limit that a command broke; empty = none
};

// `change` may make another robot of it before it starts: for robots that a test must refuse.
Outcome run(const Cell& cell, void (*change)(robot::RobotConfig&) = nullptr);

}  // namespace lithe::faults
