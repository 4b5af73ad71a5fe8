// SPDX-License-Identifier: Apache-2.0
// What somebody should know first about a robot, out of its status.
#pragma once

#include "supervisor/swap/answer.hpp"

namespace lithe::control {

// [{"level", "text"}]: "stop" where the robot or a joint is stopped or broken, or nobody keeps it; "warn" for what
// leads there or weakens a promise. The worst first; empty: all is well. `status`: as the verb answers it. What is not
// there alarms nobody.
// Contract: pure
swap::Json alarms_of(const swap::Json& status);

}  // namespace lithe::control
