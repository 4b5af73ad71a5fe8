// SPDX-License-Identifier: Apache-2.0
// Assigns cores to threads. Off the tick.
#pragma once

#include <string>
#include <vector>

#include "spine/core/host/cores.hpp"
#include "spine/core/result.hpp"
#include "spine/robot/config.hpp"

namespace lithe::robot {

// Several roles share a core when there are fewer than four.
struct CpuPlan {
  int housekeeping = 0;
  int spine = 0;
  int brain = 0;
  int transport = 0;
  bool spine_shares = false;      // another of our threads shares the Spine's core: the Spine must not spin
  bool transport_inline = false;  // no core of its own: the tick thread does the bus exchange after the tick
};

// 4 cores: one role each · 3: Brain joins housekeeping · 2: Transport moves into the tick thread · 1: all share, and
// the Spine sleeps between ticks. Isolated cores go to the Spine first, then to the Transport; housekeeping takes one
// only where there are no others, and the Brain, whose threads the kernel does not spread over isolated cores, prefers
// the others too. A core named in `wanted` is reserved for its role.
CpuPlan fold_cpus(const MachineCores& cores, const SpineConfig& wanted = {});

// The same for a robot and its buses. The error names the key, the core, and the cores that are possible.
Result<CpuPlan> plan_cpus(const RobotConfig& robot, const MachineCores& cores);

// The cores that a robot needs for itself: the Spine's, and the Transport's where it shares none. Ascending; empty when
// the Spine shares its core. What a shield keeps free, and what `lithe tune` sets up.
std::vector<int> own_cores(const CpuPlan& plan);

// The disadvantages of this plan, one sentence each; may be empty.
std::vector<std::string> costs_of(const CpuPlan& plan, const SpineConfig& wanted, const MachineCores& cores);

// Text for the isolation of a core: "isolated at boot (isolcpus), no timer tick (nohz_full)".
std::string isolation_words(const IsolatedCores& isolated, int cpu);

// Why the Spine has this core. `shared`: another of our threads runs there too.
std::string why_spine(int cpu, bool shared, const SpineConfig& wanted, const IsolatedCores& isolated);

}  // namespace lithe::robot
