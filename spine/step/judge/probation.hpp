// SPDX-License-Identifier: Apache-2.0
// Probation: judges a law that has just been committed, or parameters that have just been set, against the time before.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "lithe/law.hpp"
#include "spine/core/joints.hpp"
#include "spine/core/rt.hpp"
#include "spine/law/resident.hpp"
#include "spine/law/tremor.hpp"
#include "spine/plan/interpolator.hpp"
#include "spine/robot/config.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::step {

// Setpoint minus position of joint j, both at the time of the sample.
inline double tracking_error_rad(const Tick& in, std::uint32_t j) LITHE_RT {
  return in.setpoint_position_rad[j] - in.setpoint_velocity_rad_s[j] * in.sample_age_s - in.position_rad[j];
}

// The criteria (besides a law fault, which always replaces the law):
//   tracking    a joint's error grows beyond error_ratio times the largest of the time before the commit; a joint that
//               tracked better than kLeastErrorRad counts as having been that far off. The error is that at the time of
//               the sample: setpoint - setpoint velocity * sample_age_s - position
//   guard       in most recent ticks the guard had to clamp a joint's torque, velocity or position, or in a quarter of
//               them to slow its torque down (law/clamp_limits.hpp), and before the commit it did not
//   chatter     a joint's torque jumps up and down from tick to tick (law::Tremor)
//   oscillation a joint oscillates without decay (law::Tremor)
//   budget      the step took longer than allowed kMostLong times in a row; a single time may be the machine's fault
// Only ticks in which the robot moves, or should move, count for the duration. A robot at rest proves nothing.
//
// The time before the commit is that in which nothing was on probation. What a law, or values, on probation did is no
// measure for those that follow, whether they come one after the other or after a rollback; but for errors that were
// not judged (error_ratio 0), which the next law finds. After a rollback nothing is remembered until every joint is
// back, for at most 1 s.
// A law that begins to run may find a joint on its way out, through the law before it: for kCatchUpS the error may grow
// as far as a joint goes that brakes evenly in that time. A law that comes, or is put back a second time, while a joint
// is beyond the measure gets no more time than is left. Beyond the measure no tick counts.
// While the setpoint goes on without the law, and for kCatchUpS after that, no tracking error is judged or remembered,
// and no tick counts: when the machine stopped the tick, or the bus the exchange, for kPauseS (at least 3.5 periods);
// while no law ran; while the guard limits the torque of the soft start. The guard's limits hold all the time. For a
// law committed in this time, the errors since it began also count as errors before its commit.
// Steps of a held plan are not the law's: the error that is judged is less by what is left of their way (stepped_rad),
// they count as a speed that is asked for (step_rad_s), and while more than kLeastErrorRad is left, no clamp counts.
// While no law runs, the time before is forgotten as fast as otherwise; after a fault, at once. A law that is on
// probation when it is armed is judged from the state that it finds then: its errors count as those before.
// Parameters of an unconfirmed law get no probation of their own: they are judged with the law.
// Contract: RT · owned by the tick thread · bounded work per joint
class Probation {
 public:
  static constexpr double kLeastErrorRad = 0.05;
  static constexpr std::uint32_t kMostLong = 3;
  // A joint moves, asked or not: well above the velocity noise of a drive at rest (0.05 rad/s of a moteus; some more of
  // an encoder with noise of its own).
  static constexpr double kMovingRadS = 0.5;
  // A joint is asked to move. The setpoint has no noise.
  static constexpr double kAskedRadS = 0.01;
  // A setpoint at 3 rad/s goes on by 0.03 rad in such a pause, which is less than kLeastErrorRad.
  static constexpr double kPauseS = 0.01;
  static constexpr double kCatchUpS = 0.3;  // a good law is back at the setpoint by then

  void configure(const robot::RobotConfig& robot);

  // `law` runs from now on, and is on probation if it is unproven. `in`: what the law before it saw last. `again`: it
  // ran before, and the one after it was taken back.
  void start(const law::Resident& law, const Tick& in, bool again) LITHE_RT;
  // To be called when this command has set parameters of the active law. The new values are compared in the same way,
  // for probation_s of the robot file. If the law itself is on probation, its probation starts again, and law and
  // values are judged together.
  void start_params(std::uint64_t request_id, const Tick& in) LITHE_RT;
  std::uint64_t params_request_id() const LITHE_RT { return params_request_id_; }
  // The previous parameters are in force again.
  void end_params(const Tick& in) LITHE_RT;

  bool on() const LITHE_RT { return law_.left > 0 || params_.left > 0; }
  bool of_law() const LITHE_RT { return law_.left > 0; }
  bool of_params() const LITHE_RT { return params_.left > 0; }
  // True when the duration is over, but the robot has not moved enough.
  bool unproven() const LITHE_RT { return law_.unproven() || params_.unproven(); }

  // What it measures all the time, also after a probation.
  const law::Tremor& tremor() const LITHE_RT { return tremor_; }
  double slewed_share(std::uint32_t j) const LITHE_RT { return slewed_share_[j]; }
  // The setpoint goes on, or went on, without the law: no tracking error is judged.
  bool catching_up(const Tick& in) const LITHE_RT { return in.t_ns < catching_up_ns_; }

  struct Observed {
    const Tick& in;
    const Effort& effort;         // what the law wants
    const JointArray& torque_nm;  // and the torque of that at each joint
    std::int64_t law_ns;
    std::array<std::uint32_t, kMaxJoints> clamped;  // per joint: kClamped and kSlewed bits of what the guard did
    std::array<bool, kMaxJoints> stopped;           // joints that the law does not drive: their setpoint follows them
    bool soft_start;                                // the guard limits a torque, because the robot was just armed
    const plan::Setpoint& planned;                  // that `in` has

    double asked_rad_s(std::uint32_t j) const LITHE_RT {
      return std::max(std::abs(in.setpoint_velocity_rad_s[j]), std::abs(planned.step_rad_s[j]));
    }
  };
  // What the guard clamps, of wire::telemetry_flag.
  static constexpr std::uint32_t kClamped = wire::telemetry_flag::kTorqueClamped |
                                            wire::telemetry_flag::kVelocityClamped |
                                            wire::telemetry_flag::kPositionClamped;
  // Its slew counts while the guard does not brake the joint: then it changes the torque itself.
  static constexpr std::uint32_t kSlewed = wire::telemetry_flag::kSlewClamped;
  static constexpr std::uint32_t kBraked =
      wire::telemetry_flag::kVelocityClamped | wire::telemetry_flag::kPositionClamped;
  // Measured value and limit: tracking_lost [rad] and guard_busy [share of ticks] at `joint`, overran [s].
  struct Evidence {
    std::uint32_t joint = 0;
    double value = 0, allowed = 0;
    std::uint32_t clamped = 0;      // of guard_busy: what the guard clamps now
    law::Tremor::Finding tremor{};  // of chattering and oscillating
  };
  struct News {
    wire::LawFaultKind kind = wire::LawFaultKind::none;  // not none: replace the law or its parameters
    Evidence evidence{};
    bool law_confirmed = false, params_confirmed = false;
    bool law_unproven = false, params_unproven = false;  // as of this tick
  };
  // Once per tick in which a law ran.
  News watch(const Observed& tick) LITHE_RT;
  // Once per tick in which none did. `fault`: the robot was stopped by one.
  void rest(std::uint32_t joints, bool fault) LITHE_RT;

 private:
  struct Term {
    std::uint32_t left = 0;    // ticks of motion to go
    std::uint32_t ticks = 0;   // of the whole probation
    std::uint64_t waited = 0;  // ticks since it began
    bool unproven() const LITHE_RT { return left > 0 && waited >= ticks; }
    void start(std::uint32_t for_ticks) LITHE_RT { *this = {for_ticks, for_ticks, 0}; }
    // True on the last tick.
    bool count(bool moves) LITHE_RT {
      if (left == 0) return false;
      ++waited;
      left -= moves ? 1 : 0;
      return left == 0;
    }
  };

  double error_rad(const Tick& in, std::uint32_t j) const LITHE_RT;
  double found_rad(const Tick& in, std::uint32_t j) const LITHE_RT;
  double before_rad(std::uint32_t j) const LITHE_RT;
  bool is_back(const Tick& in) const LITHE_RT;
  bool beyond(const Tick& in) const LITHE_RT;
  void find(const Tick& in, bool again) LITHE_RT;
  void begin(const Tick& in) LITHE_RT;
  void forget_unproven(const Tick& in) LITHE_RT;
  void see_pauses(const Observed& tick) LITHE_RT;
  void compare_from_here() LITHE_RT;
  void compare_errors_from_here() LITHE_RT;
  wire::LawFaultKind find_fault(const Observed& tick, Evidence& evidence) const LITHE_RT;
  bool tracking_is_lost(const Tick& in, Evidence& evidence) const LITHE_RT;
  bool guard_is_busy(const Observed& tick, Evidence& evidence) const LITHE_RT;
  void remember(const Observed& tick) LITHE_RT;

  double forget_error_ = 0;  // per tick, of the largest error
  double forget_guard_ = 0;  // per tick, of what the guard clamped
  double forget_slew_ = 0;
  std::uint32_t params_ticks_ = 0;
  double params_error_ratio_ = 0;
  JointArray most_error_rad_{};
  JointArray stepped_rad_{};         // of the last tick in which a law ran
  std::int64_t pause_ns_ = 0;        // between two ticks
  std::int64_t last_ns_ = 0;         // of the tick before
  std::int64_t catching_up_ns_ = 0;  // until then
  JointArray paused_rad_{};          // the largest errors in it so far
  JointArray clamped_share_{};       // of recent ticks in which the guard clamped the joint
  JointArray slewed_share_{};        // in which it slowed its torque down
  law::Tremor tremor_;

  law::Terms terms_;
  Term law_, params_;
  std::uint64_t params_request_id_ = 0;  // of the command whose parameters are on probation
  double error_ratio_ = 0;
  std::uint32_t long_steps_ = 0;
  JointArray error_before_rad_{};
  std::int64_t found_until_ns_ = 0;  // until then the errors may be these
  JointArray found_rad_{};
  bool resting_ = true;                     // no law ran in the last tick
  bool put_back_ = false;                   // a law was put back, and not every joint is within the measure since
  std::int64_t returning_until_ns_ = 0;     // nothing is remembered, after a rollback until every joint is back
  std::array<bool, kMaxJoints> stopped_{};  // in the last tick
  JointArray clamped_before_{}, slewed_before_{};
};

}  // namespace lithe::step
