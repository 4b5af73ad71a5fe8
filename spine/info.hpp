// SPDX-License-Identifier: Apache-2.0
// What the Spine publishes about itself before the first tick: the core of each thread, and what this machine lacks.
#pragma once

#include <string>
#include <vector>

#include "spine/hal/actuators.hpp"
#include "spine/ipc/layout.hpp"
#include "spine/robot/config.hpp"
#include "spine/robot/cores/cpu_plan.hpp"

namespace lithe {

// Locks memory and raises the priority. Returns one sentence for each thing that did not work, after those in `known`;
// empty when all worked.
std::string describe_host(const std::vector<std::string>& known);

// Facts about the process itself.
struct Own {
  int tid_spine = 0;             // the thread that ticks
  bool protection_keys = false;  // a law cannot write the Spine's memory
  bool code_arena = false;       // laws are placed, not loaded with dlopen
};

void write_robot_info(ipc::ChannelMemory<wire::RobotInfo>& memory, const robot::RobotConfig& robot,
                      const robot::CpuPlan& cpus, const std::string& notes, const Own& own);

// What buses and drives answered wrongly or not at all; empty when nothing. To be called after the last exchange.
std::string describe_replies(const hal::Actuators& actuators);

// One JSON line for whoever started us.
std::string ready_line(const robot::RobotConfig& robot, const robot::CpuPlan& cpus, const std::string& notes);

}  // namespace lithe
