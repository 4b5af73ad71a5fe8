// SPDX-License-Identifier: Apache-2.0
// `lithe doctor`: reads this machine; no robot needs to run.
#include "host/doctor/diagnosis.hpp"

#include <fmt/format.h>

#include <iostream>

#include "host/doctor/measure/measure.hpp"
#include "spine/core/host/cores.hpp"
#include "spine/core/lookup.hpp"
#include "spine/core/text.hpp"
#include "spine/robot/cores/cpu_plan.hpp"
#include "supervisor/cli/core/act.hpp"

namespace lithe::cli {
namespace {

constexpr int kBelowTierB = 1;

// The core that a Spine which is started here gets, unless another one is asked for.
int core_for(const DoctorOptions& options) {
  const MachineCores cores = machine_cores();
  if (!options.cpu) return robot::fold_cpus(cores).spine;
  if (!contains(cores.online, *options.cpu)) {
    throw Refusal{"bad_request", fmt::format("this machine has no core {} that is on", *options.cpu),
                  fmt::format("name one of {}: lithe doctor --cpu N", cpu_list(cores.online))};
  }
  return *options.cpu;
}

// A thread that spins on the core of a running Spine would stop its robot.
void refuse_beside_spine(const host::HostFiles& files, int cpu) {
  const host::Tasks tasks = host::read_tasks(files);
  for (const host::Task& each : tasks.all) {
    if (!each.is_spine() || !each.may_run_on(cpu)) continue;
    throw Refusal{"bad_request",
                  fmt::format("a Spine (pid {}) may run on core {}: a measurement would delay it", each.pid, cpu),
                  "stop the robot first: lithe stop; or measure another core: --cpu N"};
  }
  if (!tasks.is_whole()) {
    std::cerr << fmt::format("whether a Spine runs on core {} cannot be seen ({}): it would be delayed by this", cpu,
                             tasks.why_not_whole)
              << std::endl;
  }
}

std::optional<host::Measured> measured(const host::HostFiles& files, int cpu, double seconds) {
  if (seconds <= 0) return std::nullopt;
  refuse_beside_spine(files, cpu);
  return value_of(host::measure(files, cpu, seconds), "bad_request",
                  "measure a core that this process may use: --cpu N");
}

}  // namespace

int doctor(const Context& context, const DoctorOptions& options) {
  const host::HostFiles files;
  const int cpu = core_for(options);
  const host::Diagnosis diagnosis = host::diagnose(files, cpu, measured(files, cpu, options.measure_s));
  finish(context, host::to_json(diagnosis),
         [&](const Json&) { fmt::print("{}", printable(host::to_text(diagnosis, options.all), true)); });
  return diagnosis.is_isolated() ? 0 : kBelowTierB;
}

}  // namespace lithe::cli
