// SPDX-License-Identifier: Apache-2.0
// One trial, in the process that is thrown away after it.
#pragma once

#include "trial/core/setting.hpp"
#include "trial/sandbox/sandbox.hpp"

namespace lithe::trial {

// Loads the law, lets it through all sections, writes one Report into the pipe: at its end, or from the handler of the
// signal that ended it. Returns the exit code of the process. Contract: in a child, once
int stand_trial(const Setting& setting, const Order& order, const Limits& limits, int pipe_fd);

}  // namespace lithe::trial
