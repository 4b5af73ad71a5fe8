// SPDX-License-Identifier: Apache-2.0
// Closed-loop trial: the law controls the simulated robot through the same control step as in the Spine.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "spine/core/pinned.hpp"
#include "spine/core/result.hpp"
#include "spine/law/diagnosis.hpp"
#include "spine/law/resident.hpp"
#include "spine/law/sandbox.hpp"
#include "spine/law/slot.hpp"
#include "spine/law/tremor.hpp"
#include "spine/step/step.hpp"
#include "trial/core/trial_setup.hpp"

namespace lithe::trial {

inline constexpr double kRunSeconds = 1.0;  // of the robot's time

// What the second, rough run adds to the first: each output leaves one tick late, and the following. All of it is the
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

// What an episode (trial/steps.hpp) may have otherwise than a trial's run.
struct Variation {
  std::uint64_t seed = 0;        // of the noise, and of where each joint is led; 0 = as in every trial
  double seconds = kRunSeconds;  // of the robot's time that the setpoint takes to a distance and back
};

// The robot with every mass in its plant made heavier by Rough::kPayload.
robot::RobotConfig with_payload(const robot::RobotConfig& robot);

// Opens the simulated robot and runs it until every drive is configured and on. Errors: it cannot be simulated, or a
// drive does not get ready.
Result<> open_ready(const robot::RobotConfig& robot, SimulatedRobot& simulated);

// Moves every joint that starts at or outside a position limit inside. The guard would stop it in the first tick, and
// the law would not be tried.
void start_inside(robot::RobotConfig& robot);

// Why the guard ended a run: "velocity_limit: joint wrist at 19.3 rad/s, at most 18.8".
std::array<char, 160> fault_words(const robot::RobotConfig& robot, const LoopStats& stats);

// Source of the torques in a run: the law under trial, or a replacement (none, the safe law).
class TorqueSource {
 public:
  // One step: `effort` is clear before it.
  virtual void step(const Tick& in, Effort& effort) LITHE_RT = 0;

 protected:
  ~TorqueSource() = default;
};
// No torque at all.
struct NoTorque final : TorqueSource {
  void step(const Tick&, Effort&) LITHE_RT override {}
};

// Contract: allocates nothing once made
class SimulatedRun : Pinned {
 public:
  SimulatedRun(const robot::RobotConfig& robot, const SimulatedRobot& simulated, bool rough,
               const Variation& variation = {});

  std::uint32_t ticks_in(double seconds) const;
  bool over() const { return stats.ticks >= run_ticks_; }

  // One tick: what the source wants goes through the control step to the drives. False when the guard takes over for
  // good, or a joint shakes.
  bool tick(TorqueSource& source);

  // From now on the Brain is silent. A robot with on_stale = "safe_stop" is stopped by the safe law; faults end
  // nothing, and what shook before is forgotten.
  void stop();

  const hal::ActuatorState& state() const { return state_; }  // as the drives tell it
  const wire::Telemetry& record() const { return record_; }   // of the last tick: what the source saw, the guard gave

  LoopStats stats;
  std::array<law::JointSums, kMaxJoints> sums{};  // until stop()
  std::array<bool, kMaxJoints> unjudged{};        // may be set: these joints may shake

 private:
  void watch();
  void exchange();
  void measure();
  bool fault();
  void count(const step::Report& report);
  void compose(const hal::ActuatorCommand& next);
  void disturb();
  double uniform();
  double noise();

  const robot::RobotConfig& robot_;
  hal::Actuators& actuators_;
  std::int64_t now_ns_, period_ns_;
  std::uint32_t run_ticks_;
  bool rough_, stopping_ = false;
  std::uint64_t random_;
  hal::ActuatorCommand command_, next_, late_;  // to the drives; of this tick's step; of the one before
  hal::ActuatorState state_, seen_;             // as it is, and as it is measured
  law::Slot slot_;
  law::Resident resident_;
  law::Sandbox sandbox_;
  step::ControlStep step_;
  wire::Telemetry record_{};
  wire::Plan plan_;
  law::Tremor tremor_;
  JointArray squares_rad2_{};
  std::array<std::uint32_t, kMaxJoints> held_ticks_{};
  std::array<Held, kMaxJoints> held_{};
};

// The safe law alone on the simulated robot: once, when a robot starts.
// Joints that move at half of velocity_max_rad_s are stopped by the safe law, with the bus delay and the errors that
// the robot file gives its simulation, and with the noise, the push and the late tick of the rough run. "" or, when
// a joint shakes or does not slow down, which gain of which joint, and what to write instead. A joint behind a real bus
// is simulated with its declared inertia and drive_lag_s; without a declared inertia it is not judged: what it is was
// only assumed. Errors: the robot cannot be simulated.
Result<std::string> run_safe_law(const robot::RobotConfig& robot);

}  // namespace lithe::trial
