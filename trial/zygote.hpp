// SPDX-License-Identifier: Apache-2.0
// The zygote: a prepared process that has read the robot file and forks one child per trial.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "spine/core/result.hpp"
#include "trial/core/trial_setup.hpp"

namespace lithe::trial {

// Contract: one thread · never throws for bad input: every answer is JSON with "ok"
class Zygote {
 public:
  // Reads the robot, calibrates the clock, drives the simulated robot once without a law, and lets the safe law stop it
  // (ping tells what that showed). `arena_fd`: the code arena, as the supervisor hands it over, closed here; -1 or no
  // arena = laws come as objects only.
  static Result<Zygote> make(const std::string& robot_path, int arena_fd);

  // Drops all system calls that no trial needs, for this process and its children (allow_trials_only). A child then
  // needs no filter of its own.
  // Contract: once, in a process that does nothing else
  Result<> install_filter();

  // One request line, one answer. See trial/README.md.
  nlohmann::json answer(const std::string& line);

 private:
  Zygote(TrialSetup setup, std::string arena_text, std::string safe_law_text)
      : setup_(std::move(setup)), arena_text_(std::move(arena_text)), safe_law_text_(std::move(safe_law_text)) {}

  nlohmann::json ping() const;
  nlohmann::json attempt(const nlohmann::json& request);

  TrialSetup setup_;
  std::string arena_text_;     // why there is no arena; empty = there is
  std::string safe_law_text_;  // what is wrong with its gains; empty = nothing
};

}  // namespace lithe::trial
