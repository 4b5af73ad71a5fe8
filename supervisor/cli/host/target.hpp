// SPDX-License-Identifier: Apache-2.0
// Which machine or image `lithe tune` means, and for which cores.
#pragma once

#include "host/tune/shield/shield.hpp"
#include "host/tune/tune.hpp"
#include "supervisor/cli/core/act.hpp"

namespace lithe::cli {

// The folder alone: what a revert needs. Throws the Refusal when the words name none.
host::Target place_of(const TuneWords& words);

// With the robot's cores. Throws the Refusal when the words name none, or when the machine has too few.
host::Target target_of(const TuneWords& words);

// Says on standard error what a killed shield had left, and which tasks got their cores back.
void tell_left_over(const host::Lowered& left);

}  // namespace lithe::cli
