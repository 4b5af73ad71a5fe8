// SPDX-License-Identifier: Apache-2.0
// The Spine's process. Two programs are made of it: lithe-spine, and lithe-spine-sim, which has simulated devices, too.
#pragma once

#include "spine/hal/robot_hardware.hpp"

namespace lithe {

// [--check] ROBOT.toml: creates all parts, starts the threads, waits for a signal. Returns the exit code. An empty
// `make_simulation`: a robot with a simulated bus is refused.
int run_process(int argc, char** argv, const hal::MakeSimulation& make_simulation);

}  // namespace lithe
