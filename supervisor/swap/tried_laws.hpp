// SPDX-License-Identifier: Apache-2.0
// Trial requests and closed-loop results of the laws in the Spine: later laws and parameter changes are compared with
// them.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "supervisor/link/services/services.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::control {

// Tracking is worse when the rms error is kWorseRatio times the earlier one and kWorseRad larger.
inline constexpr double kWorseRatio = 1.2;
inline constexpr double kWorseRad = 0.01;
inline constexpr double kMuchWorseRatio = 3.0;

// One sentence for each joint whose tracking error is worse than before. `run`, `before`: report.loop of two trials,
// whose inputs are the same for every law. Empty also when one of them ended early.
std::vector<std::string> worse_joints(const Json& run, const Json& before, const std::string& whom,
                                      const std::vector<std::string>& joints);

// What to do when a law's parameter `sensor`, the number of a [[sensor]] in the robot file, is none of this robot's;
// empty otherwise, also for a law without it. `values`: of all its parameters.
std::string missing_sensor(const Json& values, const wire::RobotInfo& info);

// Contract: one thread · bounded: the last kMostRuns results of the newest kMostLaws laws
class TriedLaws {
 public:
  static constexpr std::size_t kMostLaws = 32;  // more than the laws in the Spine plus those in the queue
  static constexpr std::size_t kMostRuns = 4;

  explicit TriedLaws(const SpineLink& spine) : spine_(spine) {}

  // Stores a law that has passed: its request, its parameter values, its report.
  void passed(std::uint64_t request_id, TrialRequest request, const Json& values, const Json& trial);
  // The same law with other values.
  void passed_again(std::uint64_t request_id, const Json& values, const Json& trial);
  void forget(std::uint64_t request_id) { laws_.erase(request_id); }

  // The request to try the running law again. A law committed under an earlier supervisor is taken from the law cache.
  std::optional<TrialRequest> request_of(const RunningLaw& law, const TrialRequest& otherwise) const;
  // The request to try a law again with the values that passed last, as a shared object: its slot may have been reused.
  std::optional<TrialRequest> again(std::uint64_t request_id) const;
  // worse_joints() of this trial against the trial of the running law with its present values; empty when that one is
  // unknown.
  std::vector<std::string> worse_than(const RunningLaw& law, const Json& trial) const;

 private:
  struct Run {
    Json values, loop;
  };
  struct Law {
    TrialRequest request;
    std::deque<Run> runs;  // oldest first
  };

  const SpineLink& spine_;
  std::map<std::uint64_t, Law> laws_;
};

}  // namespace lithe::control
