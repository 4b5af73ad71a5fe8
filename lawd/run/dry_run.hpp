// SPDX-License-Identifier: Apache-2.0
// Dry run: opens a compiled law in a child process, reads its descriptor and steps it on harmless inputs.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>

namespace lithe::lawd {

struct DryRun {
  bool ok = false;
  bool starved = false;  // it got too little processor time: no evidence against the law
  std::string stage;     // load | dry_run: where it failed
  std::string reason;    // one sentence: what happened and what to change
  nlohmann::json law;    // name, state[], params[], probes[], sizes
  std::uint64_t pc_offset =
      0;  // of the first invalid operation, a crash or an endless loop, from the object's start [bytes]; 0 = unknown
  double step_ns = 0;  // slowest step; for each step the fastest repetition counts
};

inline constexpr std::uint64_t kDrySteps = 1000;

// A crash, an endless loop, NaN or Inf in an output: ok = false with the reason. `joints`: of the robot, 1..kMaxJoints.
// `steps` = 0 reads the descriptor only.
DryRun dry_run(const std::string& object_path, std::uint32_t joints, std::uint64_t steps = kDrySteps);

}  // namespace lithe::lawd
