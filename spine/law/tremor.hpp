// SPDX-License-Identifier: Apache-2.0
// Detects shaking of a joint: its torque alternates from tick to tick (chatter), or the joint oscillates without decay
// (oscillation). The trial and the probation judge by the same numbers.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "lithe/law.hpp"
#include "spine/core/joints.hpp"
#include "spine/core/rt.hpp"

namespace lithe::law {

// Finds the turning points of a signal. Swings smaller than a threshold (noise) are ignored.
// Contract: RT · a value
class Zigzag {
 public:
  struct Swing {
    double size = 0;          // between the last two turning points; 0 = no turn in this tick
    std::uint32_t ticks = 0;  // between those two
  };

  Swing see(double value, double threshold) LITHE_RT {
    if (ticks_ < kLongest) ++ticks_;
    const bool further = rising_ ? value > extreme_ : value < extreme_;
    if (further) {
      at_extreme_ = ticks_;
      extreme_ = value;
      return {};
    }
    if (std::abs(value - extreme_) < threshold) return {};
    const Swing swing{std::abs(extreme_ - before_), at_extreme_};
    before_ = extreme_;
    extreme_ = value;
    rising_ = !rising_;
    ticks_ -= at_extreme_;
    at_extreme_ = ticks_;
    return swing;
  }
  std::uint32_t ticks_since_turn() const LITHE_RT { return ticks_; }

 private:
  static constexpr std::uint32_t kLongest = 1u << 30;
  double extreme_ = 0, before_ = 0;  // the farthest value since the last turn, and the turning point before it
  std::uint32_t ticks_ = 0;          // since the last turning point
  std::uint32_t at_extreme_ = 0;     // of them, until `extreme_`
  bool rising_ = true;
};

// What a held plan asks of a joint beside the setpoint's velocity.
struct SetpointSteps {
  bool now = false;  // it steps in this tick: a turn of the torque is not the law's
  double rad_s = 0;  // of the steps
};

// Contract: RT after configure() · owned by one thread · bounded work per joint
class Tremor {
 public:
  // Chatter: the torque turns by at least this share of torque_max_nm ...
  // A law with a clean sensor makes no such turns; kd_nm_s_rad times a noisy velocity stays below a tenth.
  static constexpr double kJumpShare = 0.2;
  // ... at this frequency or a higher one. The dominant frequencies of a mechanism that a law controls lie below 30 Hz.
  static constexpr double kChatterHz = 60.0;
  // ... but of a slow loop at this share of its rate; the fastest that a tick can show is half of it.
  static constexpr double kChatterOfRate = 0.25;
  static constexpr double kChatterMemoryS = 0.1;  // the frequency is averaged over so long
  // Oscillation: the velocity error turns by at least this share of velocity_max_rad_s; smaller swings do no harm ...
  static constexpr double kSwingShare = 0.1;
  // ... and by more than this many times the largest recent setpoint velocity: a commanded motion does not count ...
  static constexpr double kOfSetpoint = 2.0;
  // ... and by more than this many times the largest swing before the law was committed ...
  static constexpr double kOfBefore = 2.0;
  static constexpr double kMemoryS = 1.0;
  // ... this many times in a row (four periods), none of them smaller than this share of the one before: a stable loop
  // whose damping ratio is above 0.034 has decayed by more.
  static constexpr std::uint32_t kMostSwings = 8;
  static constexpr double kNotDecaying = 0.9;
  // ... each within this time. Slower ones are motion, which the tracking error judges.
  static constexpr double kLongestSwingS = 0.25;

  struct Bounds {
    double torque_max_nm = 1, velocity_max_rad_s = 1;
  };
  struct Finding {
    enum class Kind : std::uint8_t { none, chatter, oscillation } kind = Kind::none;
    std::uint32_t joint = 0;
    double frequency_hz = 0;
    double size = 0;        // of a swing: [N m] of chatter, [rad/s] of an oscillation, from turn to turn
    double least_size = 0;  // from which on it counts
  };

  void configure(double rate_hz, std::uint32_t joint, const Bounds& bounds) {
    rate_hz_ = rate_hz;
    chatter_hz_ = std::min(kChatterHz, kChatterOfRate * rate_hz);
    longest_swing_ = static_cast<std::uint32_t>(kLongestSwingS * rate_hz);
    forget_ = std::exp(-1.0 / (kMemoryS * rate_hz));
    forget_chatter_ = std::exp(-1.0 / (kChatterMemoryS * rate_hz));
    joints_[joint].bounds = bounds;
  }

  // To be called when a new law starts: earlier shaking does not count.
  void start() LITHE_RT {
    for (Joint& joint : joints_) {
      joint.swing_before_rad_s = joint.most_swing_rad_s;
      joint.chatter_before_hz = joint.chatter_hz;
      joint.swings = 0;
    }
  }

  // Once per tick. `torque_nm`: what the law wants at joint j.
  void see(const Tick& in, std::uint32_t j, double torque_nm, const SetpointSteps& steps = {}) LITHE_RT {
    const double error_rad_s = in.velocity_rad_s[j] - in.setpoint_velocity_rad_s[j];
    if (!std::isfinite(torque_nm) || !std::isfinite(error_rad_s)) return;  // checked elsewhere
    Joint& joint = joints_[j];
    const Zigzag::Swing jump = joint.torque.see(torque_nm, kJumpShare * joint.bounds.torque_max_nm);
    const double turned = jump.ticks > 0 && !steps.now ? 0.5 * rate_hz_ : 0.0;  // two turns make a period
    joint.chatter_hz = turned + (joint.chatter_hz - turned) * forget_chatter_;
    if (jump.ticks > 0) joint.jump_nm = jump.size;

    // A joint that follows steps has all of their speed as its error, there and back.
    const double asked_rad_s = std::max(std::abs(in.setpoint_velocity_rad_s[j]), 2 * std::abs(steps.rad_s));
    joint.most_asked_rad_s = std::max(asked_rad_s, joint.most_asked_rad_s * forget_);
    joint.most_swing_rad_s *= forget_;
    const double least_rad_s = std::max({kSwingShare * joint.bounds.velocity_max_rad_s,
                                         kOfSetpoint * joint.most_asked_rad_s, kOfBefore * joint.swing_before_rad_s});
    // Turns are found with the smallest threshold; the other two are compared with each swing.
    const Zigzag::Swing swing = joint.velocity.see(error_rad_s, kSwingShare * joint.bounds.velocity_max_rad_s);
    if (joint.velocity.ticks_since_turn() > 2 * longest_swing_) joint.swings = 0;  // at rest: a turn is detected late
    if (swing.ticks == 0) return;
    const bool goes_on = swing.ticks <= longest_swing_ && swing.size >= least_rad_s &&
                         swing.size >= kNotDecaying * joint.last_swing_rad_s;
    joint.swings = goes_on ? joint.swings + 1 : 0;
    joint.last_swing_rad_s = swing.size;
    joint.least_swing_rad_s = least_rad_s;
    joint.last_swing_ticks = swing.ticks;
    joint.most_swing_rad_s = std::max(joint.most_swing_rad_s, swing.size);
  }

  // Instead of see(), for a joint that the law does not drive now: what it did is forgotten in the same time.
  void skip(std::uint32_t j) LITHE_RT {
    Joint& joint = joints_[j];
    joint.chatter_hz *= forget_chatter_;
    joint.most_swing_rad_s *= forget_;
    joint.most_asked_rad_s *= forget_;
    joint.swings = 0;
  }

  // Instead of see(), while no law runs: what was before start() is forgotten, too. `at_once`: all of it now.
  void rest(std::uint32_t j, bool at_once) LITHE_RT {
    Joint& joint = joints_[j];
    skip(j);
    joint.chatter_before_hz *= at_once ? 0.0 : forget_chatter_;
    joint.swing_before_rad_s *= at_once ? 0.0 : forget_;
    if (at_once) joint.chatter_hz = joint.most_swing_rad_s = 0;
  }

  // A law starts, and the measure stays. Of the swings of the law before it so many count that two more are too many,
  // of its chatter half of what is allowed: else laws that come fast enough shake a joint for ever.
  void hand_on() LITHE_RT {
    for (Joint& joint : joints_) {
      joint.chatter_hz = std::min(joint.chatter_hz, 0.5 * chatter_hz_);
      joint.swings = std::min(joint.swings, kMostSwings - 2);
    }
  }

  // The law that ran since start() was taken back: all is as it was then.
  void restore() LITHE_RT {
    for (Joint& joint : joints_) {
      joint.torque = joint.velocity = {};
      joint.most_swing_rad_s = joint.swing_before_rad_s;
      joint.chatter_hz = joint.chatter_before_hz;
      joint.swings = 0;
    }
  }

  // The first of `joints` joints that shakes now.
  Finding find(std::uint32_t joints) const LITHE_RT {
    for (std::uint32_t j = 0; j < joints && j < kMaxJoints; ++j)
      if (const Finding found = find_at(j); found.kind != Finding::Kind::none) return found;
    return {};
  }
  Finding find_at(std::uint32_t j) const LITHE_RT {
    const Joint& joint = joints_[j];
    if (joint.swings >= kMostSwings) {
      return {Finding::Kind::oscillation, j, 0.5 * rate_hz_ / joint.last_swing_ticks, joint.last_swing_rad_s,
              joint.least_swing_rad_s};
    }
    if (joint.chatter_hz >= chatter_hz_ && joint.chatter_before_hz < 0.5 * chatter_hz_)
      return {Finding::Kind::chatter, j, joint.chatter_hz, joint.jump_nm, kJumpShare * joint.bounds.torque_max_nm};
    return {};
  }

  double chatter_hz(std::uint32_t j) const LITHE_RT { return joints_[j].chatter_hz; }
  std::uint32_t swings(std::uint32_t j) const LITHE_RT { return joints_[j].swings; }

 private:
  struct Joint {
    Bounds bounds;
    Zigzag torque, velocity;
    double chatter_hz = 0, chatter_before_hz = 0, jump_nm = 0;
    double most_asked_rad_s = 0, most_swing_rad_s = 0, swing_before_rad_s = 0, last_swing_rad_s = 0;
    double least_swing_rad_s = 0;
    std::uint32_t swings = 0, last_swing_ticks = 1;
  };
  double rate_hz_ = 1000, chatter_hz_ = kChatterHz, forget_ = 0, forget_chatter_ = 0;
  std::uint32_t longest_swing_ = 250;
  std::array<Joint, kMaxJoints> joints_{};
};

}  // namespace lithe::law
