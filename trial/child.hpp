// SPDX-License-Identifier: Apache-2.0
// One trial, in a child process that ends after it.
#pragma once

#include "trial/core/trial_setup.hpp"
#include "trial/sandbox/sandbox.hpp"

namespace lithe::trial {

// Loads the law, runs all sections, writes one Report into the pipe: at the end, or from the handler of the signal that
// ended it. Returns the exit code of the process.
// Contract: in a child, once
int run_trial(const TrialSetup& setup, const TrialRequest& request, const Limits& limits, int pipe_fd);

}  // namespace lithe::trial
