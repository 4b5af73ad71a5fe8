// SPDX-License-Identifier: Apache-2.0
// Closed-loop trial: the law controls the simulated robot in the order of the tick. Time is an argument.
#pragma once

#include <cstdint>
#include <limits>

#include "spine/core/result.hpp"
#include "spine/guard/guard.hpp"
#include "spine/law/tremor.hpp"
#include "spine/plan/interpolator.hpp"
#include "trial/core/setting.hpp"

namespace lithe::trial {

inline constexpr double kRideSeconds = 1.0;  // of the robot's time

// What the second, rough ride adds to the first: each output leaves one tick late, and the following. All of it is the
// same in every trial.
struct Rough {
  static constexpr std::uint64_t kSeed = 1;
  // Standard deviations of what the law measures: half a count of a 14-bit encoder, the velocity noise of a moteus at
  // rest, and its torque noise.
  static constexpr double kPositionRad = 2e-4;
  static constexpr double kVelocityRadS = 0.02;
  static constexpr double kTorqueShare = 0.01;  // of torque_max_nm
  // One push by a third of the joint's torque, as long as a knock with a hand lasts.
  static constexpr double kKickShare = 0.3;
  static constexpr double kKickFromS = 0.2, kKickS = 0.02;
  // Heavier by this share than the robot file says. A model (MJCF) stays as it is.
  static constexpr double kPayload = 0.2;
};

// The robot file's own plant with Rough::kPayload more of everything that has mass.
robot::RobotConfig with_payload(const robot::RobotConfig& robot);

// Opens it and lives until every drive is set up and on. Errors: it cannot be simulated, or a drive never gets there.
Result<> open_ready(const robot::RobotConfig& robot, SimulatedRobot& simulated);

// A joint that stands outside its limits, or at one, would be stopped in the first tick whatever the law does: nothing
// would be tried.
void start_inside(robot::RobotConfig& robot);

// Contract: allocates nothing once made · about 60 KiB
class Ride {
 public:
  Ride(const robot::RobotConfig& robot, const SimulatedRobot& simulated, bool rough);

  std::uint32_t ticks_in(double seconds) const;
  bool over() const { return stats.ticks >= ride_ticks_; }

  // The next input of the law.
  const Tick& look();

  // Its output, through the guard to the drives. False when the guard takes over for good, or a joint shakes.
  bool act(const Effort& effort);

  // A safe stop: from now on act() moves nothing, the safe law brakes, faults end nothing, and what shook before is
  // forgotten.
  void stop();

  const hal::ActuatorState& state() const { return state_; }  // as the drives tell it

  LoopStats stats;

 private:
  void watch();
  void exchange();
  void name_fault();
  void count(std::uint32_t flags, const Effort& effort);
  void compose();
  void disturb();
  double noise();

  const robot::RobotConfig& robot_;
  hal::Actuators& actuators_;
  std::int64_t now_ns_, period_ns_;
  std::uint32_t ride_ticks_;
  bool rough_;
  wire::Mode mode_ = wire::Mode::active;
  std::uint64_t random_ = Rough::kSeed;
  hal::ActuatorCommand command_;
  hal::ActuatorState state_;
  plan::Interpolator plan_;
  plan::Setpoint setpoint_;
  guard::Guard guard_;
  guard::Output output_, late_;  // of this tick, and of the one before
  law::Tremor tremor_;
  Tick tick_;
  JointArray squares_rad2_{};
  std::array<std::uint32_t, kMaxJoints> held_ticks_{};
};

}  // namespace lithe::trial
