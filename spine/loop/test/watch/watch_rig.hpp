// SPDX-License-Identifier: Apache-2.0
// Robots of any number of joints whose law follows a moving setpoint, and then turns bad or meets a load.
#pragma once

#include <array>
#include <cmath>
#include <functional>
#include <memory>
#include <string>
#include <utility>

#include "spine/hal/sim/simulate.hpp"
#include "spine/loop/test/laws_rig.hpp"
#include "spine/robot/robot.hpp"

namespace lithe::loop {

// What happens to a robot that its law cannot know of.
struct Outside {
  // A torque beside the drive's: a load, an obstacle, somebody's hand [N m]; positive pushes up.
  std::function<double(std::uint32_t joint, double position_rad, double velocity_rad_s)> load_nm;
  double share = 1;  // of the commanded torque that the drives give
};

class Loaded final : public hal::Actuators {
 public:
  Loaded(std::unique_ptr<hal::Actuators> inner, const Outside& outside) : inner_(std::move(inner)), outside_(outside) {}
  void cycle(const hal::ActuatorCommand& command, hal::ActuatorState& state, std::int64_t now_ns) LITHE_RT override {
    hal::ActuatorCommand loaded = command;
    for (std::uint32_t j = 0; j < command.joints; ++j) {
      loaded.torque_nm[j] *= outside_.share;
      if (!outside_.load_nm) continue;
      LITHE_RT_EXEMPT("a test's own function",
                      { last_nm_[j] = outside_.load_nm(j, state.position_rad[j], state.velocity_rad_s[j]); });
      loaded.torque_nm[j] += last_nm_[j];
      loaded.max_torque_nm[j] += std::abs(last_nm_[j]);
    }
    inner_->cycle(loaded, state, now_ns);
    for (std::uint32_t j = 0; j < command.joints; ++j) state.torque_nm[j] -= last_nm_[j];  // the drive's own
  }
  const hal::ReplyCounters& counters() const LITHE_RT override { return inner_->counters(); }

 private:
  std::unique_ptr<hal::Actuators> inner_;
  const Outside& outside_;
  JointArray last_nm_{};
};

enum class Turn : std::uint8_t { good, reversed, silent, undamped, hammers, chatters };

inline const char* name_of(Turn turn) {
  constexpr std::array kNames{"good", "reversed", "silent", "undamped", "hammers", "chatters"};
  return kNames[static_cast<std::size_t>(turn)];
}

// Follows its setpoint, until it is told otherwise. (A law has no other way to learn of the test.)
template <int kNumber>
struct Follower {
  static inline Turn turn = Turn::good;
  static inline bool by_target = false;         // for a drive with a loop of its own
  static inline std::uint32_t of = kMaxJoints;  // this joint only; kMaxJoints: all
  static inline JointArray kp{}, kd{}, most{}, gravity{};

  struct Params {
    Param gain{1.0, 0.1, 10.0};
  };
  struct State {};
  static void step(const Tick& t, const Params& p, State&, Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      const double error_rad = t.setpoint_position_rad[j] - t.position_rad[j];
      const double error_rad_s = t.setpoint_velocity_rad_s[j] - t.velocity_rad_s[j];
      const double nm = p.gain * kp[j] * error_rad + kd[j] * error_rad_s + gravity[j] * std::sin(t.position_rad[j]);
      const Turn now = of == kMaxJoints || of == j ? turn : Turn::good;
      if (by_target) {
        const double sign = now == Turn::reversed ? -1 : 1;
        u.position_rad[j] = t.position_rad[j] + sign * error_rad;
        u.velocity_rad_s[j] = sign * (5 * error_rad + t.setpoint_velocity_rad_s[j]);
        continue;
      }
      u.torque_nm[j] = now == Turn::reversed   ? -nm
                       : now == Turn::silent   ? 0
                       : now == Turn::undamped ? kp[j] * error_rad - 4 * kd[j] * error_rad_s
                       : now == Turn::hammers  ? nm + (t.tick / 12 % 2 == 0 ? most[j] : -most[j])
                       : now == Turn::chatters ? nm + (t.tick % 2 == 0 ? most[j] : -most[j])
                                               : nm;
    }
  }
};
using Proven = Follower<1>;
using Watched = Follower<2>;
inline constexpr LitheLaw kProven = describe<Proven>("proven");
inline constexpr LitheLaw kWatched = describe<Watched>("watched");

class WatchBench : public TickBench {
 public:
  explicit WatchBench(const robot::RobotConfig& robot)
      : TickBench(robot, std::make_unique<Loaded>(std::move(*hal::sim::simulate_actuators(robot)), outside)) {
    for (std::size_t j = 0; j < robot.joints.size(); ++j) {
      const robot::JointConfig& joint = robot.joints[j];
      middle_rad_.push_back(std::clamp(0.0, joint.position_min_rad + 0.5, joint.position_max_rad - 0.5));
    }
    Proven::turn = Watched::turn = Turn::good;
    Proven::of = Watched::of = kMaxJoints;
    Proven::by_target = Watched::by_target = false;
  }
  // Of both laws at this joint.
  static void gains(std::size_t j, double kp, double kd, double most_nm, double gravity_nm = 0) {
    Proven::kp[j] = Watched::kp[j] = kp;
    Proven::kd[j] = Watched::kd[j] = kd;
    Proven::most[j] = Watched::most[j] = most_nm;
    Proven::gravity[j] = Watched::gravity[j] = gravity_nm;
  }
  // Follows a sine on every joint for so long; a new plan 50 times a second.
  void follow(double seconds) {
    const int count = static_cast<int>(seconds * robot_.rate_hz);
    for (int i = 0; i < count; ++i) {
      if (time_ % static_cast<std::uint64_t>(robot_.rate_hz / 50) == 0) plan();
      ++time_;
      phase_ += 2 * 3.14159265358979 * hz * 1e-9 * static_cast<double>(period_ns_);
      brain_memory_->header.heartbeat_ns = now_ns_;
      tick();
      collect();
    }
  }
  // Runs the first law, then the one after it, which is confirmed.
  void begin() {
    terms_.probation_error_ratio = error_ratio;
    stage(kProven);
    ticks(3);
    for (int tries = 0; tries < 500 && send(CommandKind::arm) != CommandResult::done; ++tries) ticks(10);
    ticks(10);
    follow(1.0);
    if (with_second) stage_second();
    follow(3.0);
  }
  void stage_second() {
    terms_.probation_ticks = static_cast<std::uint32_t>(robot_.rate_hz);
    terms_.blend_ticks = 20;
    stage(kWatched);
  }
  std::uint32_t runs() { return slot_.active() == nullptr ? 0 : slot_.active()->law_id; }
  bool confirmed() { return runs() == 2 && !slot_.active()->unproven; }
  int count(EventKind kind) const {
    return static_cast<int>(std::ranges::count_if(
        all_, [kind](const wire::Event& e) { return e.kind == static_cast<std::uint32_t>(kind); }));
  }
  std::string text(EventKind kind) const {
    for (const wire::Event& event : all_)
      if (event.kind == static_cast<std::uint32_t>(kind)) return event.text.data();
    return "";
  }
  // Until the law that runs is taken away, or the robot stops, or so long: the time that it took.
  double follow_until_taken(double seconds) {
    constexpr double kPartS = 0.05;
    const std::uint32_t law = runs();
    double passed_s = 0;
    while (passed_s < seconds && runs() == law && mode() == Mode::active) {
      follow(kPartS);
      passed_s += kPartS;
    }
    return passed_s;
  }
  bool taken() { return runs() != 2 || mode() != Mode::active; }
  double middle_rad(std::size_t j) const { return middle_rad_[j]; }
  double error_rad(std::size_t j) const { return record_.setpoint_position_rad[j] - record_.position_rad[j]; }
  const wire::Telemetry& record() const { return record_; }

  bool with_second = true;
  double error_ratio = 3;
  double hz = 0.3, amplitude_rad = 0.3;
  bool held = false, square = false;  // the Brain's plans hold one target each; square: which is one end or the other
  Outside outside;

 private:
  void collect() {
    wire::Event event{};
    while (event_reader_.next(event)) all_.push_back(event);
  }
  void plan() {
    wire::Plan plan;
    plan.plan_id = ++plan_id_;
    plan.waypoint_count = wire::kNw;
    plan.joint_count = static_cast<std::uint32_t>(robot_.joints.size());
    plan.streaming = 1;
    if (held) {
      plan.waypoint_count = 1;
      plan.interpolation = static_cast<std::uint32_t>(wire::Interpolation::hold);
    }
    for (std::size_t w = 0; w < wire::kNw; ++w) {
      const double ahead_s = 0.02 * static_cast<double>(w);
      plan.t_ns[w] = now_ns_ + std::llround(1e9 * ahead_s);
      for (std::size_t j = 0; j < robot_.joints.size(); ++j) {
        const double sine = std::sin(phase_ + 2 * 3.14159265358979 * hz * ahead_s);
        plan.position_rad[w * wire::kNj + j] =
            middle_rad_[j] + amplitude_rad * (square ? std::copysign(1, sine) : sine);
        plan.velocity_rad_s[w * wire::kNj + j] = std::numeric_limits<double>::quiet_NaN();
      }
    }
    ipc::ChannelWriter<wire::Plan>(brain_memory_->plan).write(plan);
  }

  std::vector<double> middle_rad_;
  std::uint64_t time_ = 0;
  double phase_ = 0;
  ipc::RingReader<wire::Event, wire::spine_segment::kEventsTickDepth> event_reader_{memory_->events_tick};
  std::vector<wire::Event> all_;
};

}  // namespace lithe::loop
