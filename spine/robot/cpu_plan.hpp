// SPDX-License-Identifier: Apache-2.0
// Which thread gets which core, and why. Off the tick.
#pragma once

#include <string>
#include <vector>

#include "spine/core/cores.hpp"
#include "spine/core/result.hpp"
#include "spine/robot/config.hpp"

namespace lithe::robot {

// Several roles share a core when there are fewer than four.
struct CpuPlan {
  int housekeeping = 0;
  int spine = 0;
  int brain = 0;
  int transport = 0;
  bool spine_shares = false;      // something of ours runs on the Spine's core: the Spine must not spin
  bool transport_inline = false;  // no core of its own: the tick thread runs the bus cycle in its slack
};

// 4 cores: one role each · 3: Brain joins housekeeping · 2: Transport moves into the tick thread · 1: all share, and
// the Spine sleeps between ticks. Isolated cores go to the Spine first, then to the Transport; housekeeping takes one
// only where there are no others, and the Brain, whose threads the kernel does not spread over isolated cores, prefers
// the others too. A core that is named in `wanted` is kept free for its role.
CpuPlan fold_cpus(const MachineCores& cores, const SpineConfig& wanted = {});

// The same for a robot and its buses. The error names the key, the core, and which could be named instead.
Result<CpuPlan> plan_cpus(const RobotConfig& robot, const MachineCores& cores);

// In sentences, what this plan costs. Empty: nothing.
std::vector<std::string> costs_of(const CpuPlan& plan, const SpineConfig& wanted, const MachineCores& cores);

// What keeps other programs off a core: "isolated at boot (isolcpus), no timer tick (nohz_full)".
std::string isolation_words(const IsolatedCores& isolated, int cpu);

// Why the Spine has this core; `shared`: with something else of ours.
std::string why_spine(int cpu, bool shared, const SpineConfig& wanted, const IsolatedCores& isolated);

}  // namespace lithe::robot
