// SPDX-License-Identifier: Apache-2.0
#include "supervisor/core/cores.hpp"

#include <algorithm>

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

}  // namespace lithe::control
