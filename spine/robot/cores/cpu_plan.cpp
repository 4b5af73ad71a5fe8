// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/cores/cpu_plan.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "spine/core/lookup.hpp"

namespace lithe::robot {
namespace {

constexpr std::size_t kFullLayout = 4;
constexpr int kNoCore = -1;

// Cores without a role so far.
class Free {
 public:
  Free(std::vector<int> cpus, const IsolatedCores& isolated) : cpus_(std::move(cpus)), isolated_(isolated) {}

  std::size_t count() const { return cpus_.size(); }

  // The first core that is isolated (or not isolated, as asked); otherwise the first; kNoCore when all are taken.
  int take(bool isolated) {
    if (cpus_.empty()) return kNoCore;
    auto at = std::find_if(cpus_.begin(), cpus_.end(),
                           [&](int cpu) { return (isolated_.how(cpu) != Isolation::none) == isolated; });
    if (at == cpus_.end()) at = cpus_.begin();
    const int cpu = *at;
    cpus_.erase(at);
    return cpu;
  }

 private:
  std::vector<int> cpus_;
  const IsolatedCores& isolated_;
};

struct Named {
  const char* key;
  int cpu;
};

std::vector<Named> named(const SpineConfig& wanted) {
  std::vector<Named> chosen;
  for (const Named& each : {Named{"cpu_spine", wanted.cpu_spine}, Named{"cpu_transport", wanted.cpu_transport},
                            Named{"cpu_brain", wanted.cpu_brain}, Named{"cpu_housekeeping", wanted.cpu_housekeeping}})
    if (each.cpu != kAutoCpu) chosen.push_back(each);
  return chosen;
}

std::string why_not(int cpu, const MachineCores& cores) {
  if (!contains(cores.online, cpu)) return fmt::format("this machine has cores {}", cpu_list(cores.online));
  if (!cores.granted.empty() && !contains(cores.granted, cpu))
    return fmt::format("the cpuset of this process has cores {}", cpu_list(cores.granted));
  return fmt::format("this process was started on cores {} (taskset?)", cpu_list(cores.affinity));
}

bool shares(const CpuPlan& plan) {
  return plan.spine == plan.housekeeping || plan.spine == plan.brain ||
         (!plan.transport_inline && plan.transport == plan.spine);
}

}  // namespace

CpuPlan fold_cpus(const MachineCores& cores, const SpineConfig& wanted) {
  std::vector<int> left = cores.automatic();
  if (left.empty()) left = {0};
  const int first = left.front();
  for (const Named& each : named(wanted)) left.erase(std::remove(left.begin(), left.end(), each.cpu), left.end());
  Free free(std::move(left), cores.isolated);
  const auto pick = [](int asked, int chosen, int otherwise) {
    return asked != kAutoCpu ? asked : chosen != kNoCore ? chosen : otherwise;
  };
  const auto take_for = [&](int asked, bool isolated) { return asked == kAutoCpu ? free.take(isolated) : kNoCore; };

  CpuPlan plan;
  plan.housekeeping = pick(wanted.cpu_housekeeping, take_for(wanted.cpu_housekeeping, false), first);
  plan.spine = pick(wanted.cpu_spine, take_for(wanted.cpu_spine, true), plan.housekeeping);
  // With two cores left, the Brain gets one; with one left, the Transport gets it.
  const bool for_both = free.count() >= (wanted.cpu_transport == kAutoCpu ? 2 : 1);
  const int brain = for_both ? take_for(wanted.cpu_brain, false) : kNoCore;
  plan.brain = pick(wanted.cpu_brain, brain, plan.housekeeping);
  const int transport = take_for(wanted.cpu_transport, true);
  plan.transport = pick(wanted.cpu_transport, transport, plan.spine);
  plan.transport_inline = wanted.cpu_transport == kAutoCpu && transport == kNoCore;
  plan.spine_shares = shares(plan);
  return plan;
}

Result<CpuPlan> plan_cpus(const RobotConfig& robot, const MachineCores& cores) {
  const SpineConfig& wanted = robot.spine;
  const std::vector<int> usable = cores.usable();
  for (const Named& each : named(wanted)) {
    if (contains(usable, each.cpu)) continue;
    return Error{fmt::format("{}: spine.{} = {}, but {}; name one of {}, or leave it out to let the program choose",
                             robot.path, each.key, each.cpu, why_not(each.cpu, cores), cpu_list(usable))};
  }
  CpuPlan plan = fold_cpus(cores, wanted);
  // A loop bus is memory. Hardware needs system calls, which the tick must not make.
  const bool all_loops = std::none_of(robot.buses.begin(), robot.buses.end(), is_real);
  if (wanted.transport == TransportPlace::inlined && !all_loops) {
    return Error{fmt::format(
        "{}: [spine] transport = \"inline\" is for simulated buses only: a tick never calls the kernel; leave it out",
        robot.path)};
  }
  if (wanted.transport != TransportPlace::automatic || !all_loops) {
    plan.transport_inline = wanted.transport == TransportPlace::inlined;
    if (!plan.transport_inline && plan.transport == plan.spine) plan.transport = plan.housekeeping;
  }
  plan.spine_shares = shares(plan);
  return plan;
}

std::vector<int> own_cores(const CpuPlan& plan) {
  if (shares(plan)) return {};
  std::vector<int> cores = {plan.spine};
  const bool own = plan.transport != plan.housekeeping && plan.transport != plan.brain;
  if (!plan.transport_inline && own) cores.push_back(plan.transport);
  std::sort(cores.begin(), cores.end());
  return cores;
}

std::vector<std::string> costs_of(const CpuPlan& plan, const SpineConfig& wanted, const MachineCores& cores) {
  std::vector<std::string> costs;
  const std::size_t here = cores.automatic().size();
  if (here < kFullLayout) {
    const std::string have =
        here < cores.online.size()
            ? fmt::format("this process may use {} of this machine's {} cores", here, cores.online.size())
            : fmt::format("this machine has {} core{}", here, here == 1 ? "" : "s");
    costs.push_back(fmt::format("{}, the full layout uses 4: threads share cores (docs/rt.md)", have));
  }
  if (plan.spine_shares)
    costs.push_back(fmt::format("the Spine shares core {}: it sleeps between ticks instead of spinning", plan.spine));
  if (plan.transport_inline) {
    costs.push_back(wanted.transport == TransportPlace::inlined
                        ? "the tick thread serves the buses itself, as the robot file asks"
                        : "no core is left for the Transport: the tick thread serves the buses itself");
  }
  return costs;
}

std::string isolation_words(const IsolatedCores& isolated, int cpu) {
  std::string words = "not isolated, other programs may run there";
  const Isolation how = isolated.how(cpu);
  if (how == Isolation::boot) words = "isolated at boot (isolcpus)";
  if (how == Isolation::cpuset) words = "isolated by its cpuset (a partition of cgroup v2)";
  if (how == Isolation::none && !isolated.all().empty())
    words += fmt::format("; isolated are {}: spine.cpu_spine can name one", cpu_list(isolated.all()));
  return words + (isolated.is_tickless(cpu) ? ", no timer tick (nohz_full)" : "");
}

std::string why_spine(int cpu, bool shared, const SpineConfig& wanted, const IsolatedCores& isolated) {
  if (wanted.cpu_spine == cpu) return "the robot file names it";
  if (isolated.how(cpu) != Isolation::none) return "isolated cores come first";
  return shared ? "no other core is left" : "nothing else of LITHE runs there";
}

}  // namespace lithe::robot
