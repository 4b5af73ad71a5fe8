// SPDX-License-Identifier: Apache-2.0
// The cores of the supervisor and the compilers: all but those of the Spine and the Transport.
#pragma once

#include <vector>

namespace lithe::control {

// `allowed` without the Spine's core and the Transport's; never empty unless `allowed` is.
std::vector<int> cores_beside(const std::vector<int>& allowed, int spine_cpu, int transport_cpu);

}  // namespace lithe::control
