// SPDX-License-Identifier: Apache-2.0
// The robot's status as one JSON document.
#pragma once

#include "spine/robot/config.hpp"
#include "supervisor/core/answer.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::control {

// `robot`: gives the kind of each joint's drive.
Json status_json(const SpineLink& spine, const robot::RobotConfig& robot);
// {"law","law_id","params":[{"name","value","min","max"}]} of the running law.
Answer params_json(const SpineLink& spine);
// Laws loaded in the Spine: [{"law","law_id","active","params":[...],"probes":[...]}]
Json resident_json(const SpineLink& spine);

}  // namespace lithe::control
