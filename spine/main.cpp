// SPDX-License-Identifier: Apache-2.0
// lithe-spine [--check] ROBOT.toml: the Spine of a robot on real buses. `lithe run` starts it. No simulated device is
// linked into it (docs/adr/0020).
#include "spine/process.hpp"

int main(int argc, char** argv) { return lithe::run_process(argc, argv, {}); }
