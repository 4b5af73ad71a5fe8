// SPDX-License-Identifier: Apache-2.0
// How the laws in the Spine are tried, and how they rode with the simulated robot: what their parameters and the next
// law are held against.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "supervisor/link/spine_link.hpp"
#include "supervisor/link/trial_link.hpp"

namespace lithe::control {

// What a better ride of the same robot is called worse by: this many times the error, and so much more of it.
inline constexpr double kWorseRatio = 1.2;
inline constexpr double kWorseRad = 0.01;
inline constexpr double kMuchWorseRatio = 3.0;

// The joints that were farther from their setpoint in one ride than in another, one sentence each. `ride`, `before`:
// report.loop of two trials, which are the same for every law. Empty, too, when one of them ended early.
std::vector<std::string> worse_joints(const swap::Json& ride, const swap::Json& before, const std::string& whom,
                                      const std::vector<std::string>& joints);

// Contract: one thread · bounded: of each law the last rides, of all the newest laws
class TriedLaws {
 public:
  static constexpr std::size_t kMostLaws = 32;  // more than the Spine and a queue under way hold
  static constexpr std::size_t kMostRides = 4;

  explicit TriedLaws(const SpineLink& spine) : spine_(spine) {}

  // A law that has passed: by its request, with the values of its parameters, and its report.
  void passed(std::uint64_t request_id, TrialOrder order, const swap::Json& values, const swap::Json& trial);
  // The same law with other values.
  void passed_again(std::uint64_t request_id, const swap::Json& values, const swap::Json& trial);
  void forget(std::uint64_t request_id) { laws_.erase(request_id); }

  // How the running law can be tried again. One that an earlier supervisor brought in: from the law cache.
  std::optional<TrialOrder> order_of(const RunningLaw& law, const TrialOrder& otherwise) const;
  // worse_joints() of this trial and of the one that the running law passed with the values it has now; empty when
  // nobody knows that one.
  std::vector<std::string> worse_than(const RunningLaw& law, const swap::Json& trial) const;

 private:
  struct Ride {
    swap::Json values, loop;
  };
  struct Law {
    TrialOrder order;
    std::deque<Ride> rides;  // oldest first
  };

  const SpineLink& spine_;
  std::map<std::uint64_t, Law> laws_;
};

}  // namespace lithe::control
