// SPDX-License-Identifier: Apache-2.0
// Which cores the supervisor and the compilers keep to, so that the Spine and the Transport have theirs alone.
#pragma once

#include <vector>

#include "spine/robot/config.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::control {

// `allowed` without the Spine's core and the Transport's; never empty unless `allowed` is.
std::vector<int> cores_beside(const std::vector<int>& allowed, int spine_cpu, int transport_cpu);

// The same before the Spine has said where it runs: what the file asks for, else the fold of `allowed`.
std::vector<int> cores_beside(const std::vector<int>& allowed, const robot::SpineConfig& wanted);

}  // namespace lithe::control
