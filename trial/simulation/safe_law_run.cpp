// SPDX-License-Identifier: Apache-2.0

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "spine/law/tremor.hpp"
#include "spine/robot/limits/limits.hpp"
#include "trial/simulation/simulated_run.hpp"

namespace lithe::trial {
namespace {

using robot::JointConfig;
using robot::RobotConfig;
using Kind = law::Tremor::Finding::Kind;

constexpr double kStartShare = 0.5;  // of velocity_max_rad_s: so fast when the stop begins
constexpr double kPushS = 0.5;       // for so long at most they are brought there
constexpr double kGrowS = 0.1;       // until the torque that does it is all there is
constexpr double kLeastStart = 0.1;  // of velocity_max_rad_s: slower than this, slowing down cannot be judged
constexpr double kNoSlower = 0.9;    // of the speed that it had: it has not slowed down
constexpr double kAfterS = 0.5;      // the run goes on for so long after the safe law's own ramp
constexpr double kMostStopS = 3.0;   // and ends here
constexpr double kLastS = 0.25;      // in which a joint must be slower than it was
constexpr double kAny = 1e9;
constexpr int kMostTries = 10;  // of smaller and larger values

// What the safe law did wrong.
struct Finding {
  enum class What { nothing, shakes, goes_on } what = What::nothing;
  std::size_t joint = 0;
  Kind kind = Kind::none;
  double size = 0, hz = 0;           // of the shaking
  double from_rad_s = 0, rad_s = 0;  // before the stop, and at its end
};

// A joint that the robot file describes, and not one that was assumed.
bool known(const RobotConfig& robot, const JointConfig& joint) {
  return robot::is_simulated(robot, joint) || joint.inertia_declared ||
         robot.plant.kind != robot::PlantKind::independent;
}

// What is simulated is what the robot file says of the joint, whether it is simulated or real.
RobotConfig model_of(RobotConfig robot) {
  robot.guard.soft_start_s = 0;
  robot.guard.brake_after_s = robot.guard.off_after_s = 0;  // the safe law alone
  robot.brain.on_stale = robot::StaleAction::safe_stop;     // so SimulatedRun::stop() stops it
  for (JointConfig& joint : robot.joints) {
    if (robot.plant.kind != robot::PlantKind::independent || robot::is_simulated(robot, joint)) continue;
    joint.sim.inertia_kg_m2 = joint.inertia_min_kg_m2 > 0 ? joint.inertia_min_kg_m2 : joint.sim.inertia_kg_m2;
    joint.sim.torque_lag_s = joint.drive_lag_s;
  }
  start_inside(robot);
  return robot;
}

// Brings the joints to speed, each towards the side with more room: with a torque that grows slowly, so that a light
// one is not far beyond it before that is seen. One that was there once is let go.
class Push final : public TorqueSource {
 public:
  explicit Push(const RobotConfig& robot) : robot_(robot) {}

  void step(const Tick& tick, Effort& effort) LITHE_RT override {
    share_ = std::min(share_ + tick.dt_s / kGrowS, 1.0);
    pushes_ = false;
    for (std::uint32_t j = 0; j < joints(); ++j) {
      const JointConfig& joint = robot_.joints[j];
      gone_[j] = gone_[j] || std::abs(tick.velocity_rad_s[j]) >= kStartShare * joint.velocity_max_rad_s;
      const double middle_rad = 0.5 * (joint.position_min_rad + joint.position_max_rad);
      if (sign_[j] == 0) sign_[j] = tick.position_rad[j] > middle_rad ? -1 : 1;
      effort.torque_nm[j] = gone_[j] ? 0 : sign_[j] * share_ * joint.torque_max_nm;
      pushes_ = pushes_ || !gone_[j];
    }
  }
  // False when all are let go.
  bool pushes() const { return pushes_; }

 private:
  std::uint32_t joints() const { return static_cast<std::uint32_t>(robot_.joints.size()); }

  const RobotConfig& robot_;
  bool pushes_ = true;
  double share_ = 0;  // of torque_max_nm
  std::array<bool, kMaxJoints> gone_{};
  JointArray sign_{};
};

double stop_s(const RobotConfig& robot) {
  double longest_s = 0;
  for (const JointConfig& joint : robot.joints)
    longest_s = std::max(longest_s, kStartShare * joint.velocity_max_rad_s / joint.deceleration_rad_s2);
  return std::min(longest_s + kAfterS, kMostStopS);
}

// The joints that are not judged: what is wrong with them has been said.
using Told = std::array<bool, kMaxJoints>;

// Up to this a simulated encoder measures a joint at rest as moving: two of its steps in a tick.
double unseen_rad_s(const RobotConfig& robot, const JointConfig& joint) {
  return 4 * std::numbers::pi / (joint.sim.encoder_counts * joint.ratio) * robot.rate_hz;
}

// The first joint that is judged and does not slow down.
Finding slowed_down(const RobotConfig& robot, const Told& told, const JointArray& from_rad_s,
                    const JointArray& last_rad_s) {
  for (std::size_t j = 0; j < robot.joints.size(); ++j) {
    const JointConfig& joint = robot.joints[j];
    const bool moved = from_rad_s[j] >= kLeastStart * joint.velocity_max_rad_s;
    // What falls under its load, damped, may become faster than it was, but not fast.
    const double most_rad_s = std::max(kNoSlower * std::max(from_rad_s[j], kStartShare * joint.velocity_max_rad_s),
                                       unseen_rad_s(robot, joint));
    if (!moved || last_rad_s[j] < most_rad_s || told[j] || !known(robot, joint)) continue;
    return {.what = Finding::What::goes_on, .joint = j, .from_rad_s = from_rad_s[j], .rad_s = last_rad_s[j]};
  }
  return {};
}

Result<Finding> stop_with_safe_law(const RobotConfig& robot, const Told& told = {}) {
  SimulatedRobot simulated;
  if (const auto opened = open_ready(robot, simulated); !opened) return opened.error();
  SimulatedRun run(robot, simulated, true);
  Push push(robot);
  while (run.stats.ticks < run.ticks_in(kPushS) && push.pushes() && run.tick(push)) continue;

  run.stop();
  const std::uint32_t end = run.stats.ticks + run.ticks_in(stop_s(robot)), last = end - run.ticks_in(kLastS);
  JointArray from_rad_s{}, last_rad_s{};
  NoTorque no_torque;
  for (std::size_t j = 0; j < robot.joints.size(); ++j) {
    from_rad_s[j] = std::abs(run.state().velocity_rad_s[j]);
    run.unjudged[j] = told[j] || !known(robot, robot.joints[j]);
  }
  while (run.stats.ticks < end) {
    if (!run.tick(no_torque)) {
      const LoopStats& stats = run.stats;
      return Finding{.what = Finding::What::shakes,
                     .joint = stats.tremor_joint,
                     .kind = Kind{static_cast<std::uint8_t>(stats.tremor)},
                     .size = stats.tremor_size,
                     .hz = stats.tremor_hz};
    }
    if (run.stats.ticks <= last) continue;
    for (std::size_t j = 0; j < robot.joints.size(); ++j)
      last_rad_s[j] = std::max(last_rad_s[j], std::abs(run.state().velocity_rad_s[j]));
  }
  return slowed_down(robot, told, from_rad_s, last_rad_s);
}

// Whether that joint stops well with this gain, whatever the others do.
bool does(RobotConfig robot, std::size_t joint, double JointConfig::* gain, double value) {
  robot.joints[joint].*gain = value;
  if (!robot::safe_gains_fit(robot, robot.joints[joint])) return false;  // the robot file's check would refuse it
  Told others;
  others.fill(true);
  others[joint] = false;
  const auto found = stop_with_safe_law(robot, others);
  return found && found->what == Finding::What::nothing;
}

// The first that does of `value` times `by`, times `by` again, up to `most`. 0: none.
double other_value(const RobotConfig& robot, std::size_t joint, double JointConfig::* gain, double by, double most) {
  for (int i = 1; i <= kMostTries; ++i) {
    const double value = robot.joints[joint].*gain * std::pow(by, i);
    if (value > most) break;
    if (const double told = std::stod(fmt::format("{:.2g}", value)); does(robot, joint, gain, told)) return told;
  }
  return 0;
}

// What else makes it shake or go on: what its encoder cannot tell from rest; a range in which the guard itself must
// brake it all the time; or what the file says that it moves.
std::string other_than_gains(const RobotConfig& robot, std::size_t index) {
  const JointConfig& joint = robot.joints[index];
  const double finer = unseen_rad_s(robot, joint) / (law::Tremor::kSwingShare * joint.velocity_max_rad_s);
  if (finer > 1 && robot::is_simulated(robot, joint)) {
    return fmt::format(
        "its encoder measures no speed below {:.2g} rad/s; in its [joint.sim] write encoder_counts = {:.0f} or more",
        unseen_rad_s(robot, joint), std::exp2(std::ceil(std::log2(joint.sim.encoder_counts * finer))));
  }
  if (const std::string advice = robot::way_advice(robot, joint); !advice.empty()) return "it " + advice;
  struct Key {
    const char* name;
    double JointConfig::* key;
    double by, most;
  };
  for (const Key& each : {Key{"inertia_min_kg_m2", &JointConfig::inertia_min_kg_m2, 2, joint.inertia_max_kg_m2},
                          Key{"velocity_max_rad_s", &JointConfig::velocity_max_rad_s, 0.7, joint.velocity_max_rad_s},
                          Key{"torque_slew_nm_s", &JointConfig::torque_slew_nm_s, 2, kAny}})
    if (const double value = other_value(robot, index, each.key, each.by, each.most); value > 0)
      return fmt::format("the guard itself shakes it; where it is true, write {} = {:.2g} or {}", each.name, value,
                         each.by > 1 ? "more" : "less");
  std::string what;
  switch (robot.plant.kind) {
    case robot::PlantKind::mujoco:
      what = fmt::format("the masses and the armature of this joint in {}", robot.plant.model);
      break;
    case robot::PlantKind::chain:
      what = "mass_kg, center_m, link_inertia_kg_m2 and rotor_inertia_kg_m2 in its [joint.sim]";
      break;
    case robot::PlantKind::independent:
      what = robot::is_simulated(robot, joint)
                 ? fmt::format("inertia_kg_m2 in its [joint.sim], which is {:.3g}", joint.sim.inertia_kg_m2)
                 : fmt::format("inertia_min_kg_m2, which is {:.3g}", joint.inertia_min_kg_m2);
  }
  return fmt::format("correct {}, or drive_lag_s = {:g}", what, joint.drive_lag_s);
}

std::string shaking(const RobotConfig& robot, const Finding& found) {
  const JointConfig& joint = robot.joints[found.joint];
  const bool chatters = found.kind == Kind::chatter;
  const std::string how =
      chatters
          ? fmt::format(
                "its torque jumps up and down by {:.2g} N m, {:.0f} times a second (from {:.2g} N m on, {:.0f} "
                "are too many)",
                found.size, found.hz, law::Tremor::kJumpShare * joint.torque_max_nm,
                std::min(law::Tremor::kChatterHz, law::Tremor::kChatterOfRate * robot.rate_hz))
          : fmt::format(
                "it swings to and fro by {:.2g} rad/s at {:.1f} Hz without decay (from {:.2g} rad/s on, {} "
                "swings are too many)",
                found.size, found.hz, law::Tremor::kSwingShare * joint.velocity_max_rad_s, law::Tremor::kMostSwings);
  const bool stiff = joint.safe_kp_nm_rad > 0 && does(robot, found.joint, &JointConfig::safe_kp_nm_rad, 0);
  const auto gain = stiff ? &JointConfig::safe_kp_nm_rad : &JointConfig::safe_kd_nm_s_rad;
  const char* key = stiff ? "safe_kp_nm_rad" : "safe_kd_nm_s_rad";
  const double good = other_value(robot, found.joint, gain, 0.7, joint.*gain);
  const double more =
      good > 0 ? 0 : other_value(robot, found.joint, &JointConfig::safe_kd_nm_s_rad, 2, joint.kd_max_nm_s_rad);
  return fmt::format("joint {}: {} = {:g} shakes it when the safe law stops the simulated robot: {}; {}", joint.name,
                     key, joint.*gain, how,
                     good > 0   ? fmt::format("write {} = {:.2g} or less", key, good)
                     : more > 0 ? fmt::format("the guard shakes it, so little does the safe law; write "
                                              "safe_kd_nm_s_rad = {:.2g} or more",
                                              more)
                                : "no other gain helps; " + other_than_gains(robot, found.joint));
}

std::string going_on(const RobotConfig& robot, const Finding& found) {
  const JointConfig& joint = robot.joints[found.joint];
  const double good = other_value(robot, found.joint, &JointConfig::safe_kd_nm_s_rad, 2, joint.kd_max_nm_s_rad);
  return fmt::format(
      "joint {}: safe_kd_nm_s_rad = {:g} does not slow it down: the safe law stops the simulated robot, and the joint, "
      "which had {:.2g} rad/s, has {:.2g} at the end; it must have less; {}",
      joint.name, joint.safe_kd_nm_s_rad, found.from_rad_s, found.rad_s,
      good > 0 ? fmt::format("write safe_kd_nm_s_rad = {:.2g} or more", good)
               : "no gain up to kd_max_nm_s_rad helps; " + other_than_gains(robot, found.joint));
}

}  // namespace

Result<std::string> run_safe_law(const RobotConfig& robot) {
  const RobotConfig model = model_of(robot);
  std::string text;
  Told told{};
  for (std::size_t i = 0; i < model.joints.size(); ++i) {  // each run ends at the first joint that fails
    const auto found = stop_with_safe_law(model, told);
    if (!found) return found.error();
    if (found->what == Finding::What::nothing) break;
    text += (text.empty() ? "" : "\n") +
            (found->what == Finding::What::shakes ? shaking(model, *found) : going_on(model, *found));
    told[found->joint] = true;
  }
  return text;
}

}  // namespace lithe::trial
