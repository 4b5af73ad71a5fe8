// SPDX-License-Identifier: Apache-2.0
// What a guard that judges each joint alone promises: where it expects the joint, from the answer it had, an output
// differs from the one that was sent before it by a slew step at most.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "spine/core/pd.hpp"
#include "spine/robot/config.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::limits {

class Promise {
 public:
  explicit Promise(const robot::RobotConfig& robot) : robot_(robot) {}

  // Before each decision. Where a joint is when the next command reaches its drive, if it keeps the speed of its last
  // answer, which is `age_s` old, and older where answers are missing.
  void expect(const JointArray& position_rad, const JointArray& velocity_rad_s,
              const std::array<std::uint32_t, kMaxJoints>& status, double age_s, std::uint32_t stale) {
    for (std::size_t j = 0; j < robot_.joints.size(); ++j) {
      const bool fresh = (status[j] & wire::joint_status::kFresh) != 0;
      without_answer_[j] = fresh ? 0 : without_answer_[j] + (stale == 0 ? 1 : 0);
      velocity_rad_s_[j] = velocity_rad_s[j];
      position_rad_[j] = position_rad[j] + velocity_rad_s[j] * (age_s + (1 + without_answer_[j]) / robot_.rate_hz);
    }
  }

  // When an output is sent: the largest difference of a joint, of its slew per tick.
  double share_of(const JointCommands& output) {
    double most = 0;
    for (std::size_t j = 0; j < robot_.joints.size(); ++j) {
      const double most_nm = robot_.joints[j].torque_max_nm;
      const auto felt_nm = [&](const JointCommands& by) {
        return std::clamp(pd_of(by, j).felt_nm(position_rad_[j], velocity_rad_s_[j]), -most_nm, most_nm);
      };
      const double step_nm = robot_.joints[j].torque_slew_nm_s / robot_.rate_hz;
      most = std::max(most, std::abs(felt_nm(output) - felt_nm(sent_)) / step_nm);
    }
    sent_ = output;
    return most;
  }

 private:
  const robot::RobotConfig& robot_;
  JointArray position_rad_{}, velocity_rad_s_{};
  std::array<int, kMaxJoints> without_answer_{};
  JointCommands sent_;
};

}  // namespace lithe::limits
