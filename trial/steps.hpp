// SPDX-License-Identifier: Apache-2.0
// Episodes for programs that learn: they give the torques, and see what a law would see on the simulated robot.
#pragma once

#include <cstdint>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "spine/core/result.hpp"
#include "trial/simulation/simulated_run.hpp"

namespace lithe::trial {

// Contract: one thread · never throws for bad input: every answer is JSON with "ok"
class Steps {
 public:
  // Errors: as load_robot(), and a robot with a real bus: what hangs on it would only be assumed.
  static Result<std::unique_ptr<Steps>> make(const std::string& robot_path);

  // One request line, one answer. See trial/README.md.
  nlohmann::json answer(const std::string& line);

 private:
  // The torques of the last request, in every tick until the next.
  struct Held final : TorqueSource {
    void step(const Tick&, Effort& effort) LITHE_RT override { effort.torque_nm = torque_nm; }
    JointArray torque_nm{};
  };

  explicit Steps(robot::RobotConfig robot);

  nlohmann::json describe() const;
  nlohmann::json reset(const nlohmann::json& request);
  nlohmann::json step(const nlohmann::json& request);
  nlohmann::json advance(std::uint32_t ticks);
  bool over() const { return run_->stats.fault != 0 || run_->stats.ticks >= end_; }

  const robot::RobotConfig robot_;
  robot::RobotConfig plain_, heavy_;  // as a trial simulates it, without and with a payload
  SimulatedRobot simulated_;          // of this episode
  std::optional<SimulatedRun> run_;   // likewise
  std::uint32_t ticks_ = 1, end_ = 0;
  Held held_;
};

}  // namespace lithe::trial
