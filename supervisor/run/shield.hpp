// SPDX-License-Identifier: Apache-2.0
// How the status of a robot tells its shield.
#pragma once

#include "host/tune/shield/shield.hpp"
#include "supervisor/core/answer.hpp"

namespace lithe::control {

Json shield_json(const host::Shield& shield);

}  // namespace lithe::control
