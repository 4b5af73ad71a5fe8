// SPDX-License-Identifier: Apache-2.0
// lithe-spine-sim [--check] ROBOT.toml: the Spine of a robot with a bus of kind "loop". `lithe run` starts it.
#include "spine/hal/sim/simulate.hpp"
#include "spine/process.hpp"

int main(int argc, char** argv) { return lithe::run_process(argc, argv, lithe::hal::sim::make_simulation); }
