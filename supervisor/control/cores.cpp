// SPDX-License-Identifier: Apache-2.0
#include "supervisor/control/cores.hpp"

#include <algorithm>

#include "spine/core/host.hpp"

namespace lithe::control {

std::vector<int> cores_beside(const std::vector<int>& allowed, int spine_cpu, int transport_cpu) {
  std::vector<int> rest = allowed;
  for (const int taken : {spine_cpu, transport_cpu}) {
    std::vector<int> without = rest;
    without.erase(std::remove(without.begin(), without.end(), taken), without.end());
    if (!without.empty()) {
      rest = std::move(without);
    }
  }
  return rest;
}

std::vector<int> cores_beside(const std::vector<int>& allowed, const robot::SpineConfig& wanted) {
  const CpuPlan fold = fold_cpus(allowed);
  const auto pick = [&allowed](int asked, int automatic) {
    return std::find(allowed.begin(), allowed.end(), asked) != allowed.end() ? asked : automatic;
  };
  return cores_beside(allowed, pick(wanted.cpu_spine, fold.spine), pick(wanted.cpu_transport, fold.transport));
}

}  // namespace lithe::control
