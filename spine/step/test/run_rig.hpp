// SPDX-License-Identifier: Apache-2.0
// A control step in a closed loop with a robot's simulated drives, and one that is fed with what another one was given.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <optional>
#include <string>

#include "spine/core/time.hpp"
#include "spine/hal/sim/simulate.hpp"
#include "spine/robot/robot.hpp"
#include "spine/step/step.hpp"

namespace lithe::step {

using wire::CommandKind;
using wire::Mode;

// Its State is carried from law to law.
struct Soft {
  struct Params {
    Param kp_nm_rad{4.0, 0.0, 40.0}, kd_nm_s_rad{0.1, 0.0, 4.0};
  };
  struct State {
    double integral_rad_s = 0;
  };
  static void step(const Tick& t, const Params& p, State& s, Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      const double error_rad = t.setpoint_position_rad[j] - t.position_rad[j];
      s.integral_rad_s += error_rad * t.dt_s;
      u.torque_nm[j] = p.kp_nm_rad * error_rad - p.kd_nm_s_rad * t.velocity_rad_s[j] + t.input[0];
    }
  }
};
// The drive's own PD does the work; now and then it has no target.
struct InTheDrive {
  struct Params {};
  struct State {
    double integral_rad_s = 0, steps = 0;
  };
  static void step(const Tick& t, const Params&, State& s, Effort& u) {
    s.steps += 1;
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      if (t.tick % 200 > 20) u.position_rad[j] = t.setpoint_position_rad[j];
      u.velocity_rad_s[j] = t.setpoint_velocity_rad_s[j];
      u.kp_nm_rad[j] = 4;
      u.kd_nm_s_rad[j] = 0.1;
    }
  }
};
struct LateNan {  // finite for ten steps
  struct Params {};
  struct State {
    double steps = 0;
  };
  static void step(const Tick&, const Params&, State& s, Effort& u) {
    if (++s.steps > 10) u.torque_nm[0] = std::numeric_limits<double>::quiet_NaN();
  }
};
inline const RawClock kWallClock = RawClock::calibrate();
inline double g_steps = 0;
// What a law must not do. The least that a clock tells, in its torque.
struct ReadsAClock {
  struct Params {};
  struct State {};
  static void step(const Tick&, const Params&, State&, Effort& u) {
    u.torque_nm[0] = 1e-9 * static_cast<double>(kWallClock.now_ns() % 1000);
  }
};
// Likewise: what it remembers is not in its State.
struct RemembersOutside {
  struct Params {};
  struct State {};
  static void step(const Tick&, const Params&, State&, Effort& u) { u.torque_nm[0] = 1e-6 * ++g_steps; }
};
inline constexpr LitheLaw kSoft = describe<Soft>("soft");
inline constexpr LitheLaw kInTheDrive = describe<InTheDrive>("in_the_drive");
inline constexpr LitheLaw kLateNan = describe<LateNan>("late_nan");
inline constexpr LitheLaw kReadsAClock = describe<ReadsAClock>("reads_a_clock");
inline constexpr LitheLaw kRemembersOutside = describe<RemembersOutside>("remembers_outside");

// All that one step was given, by value: what a recorder would keep.
struct Given {
  std::uint64_t tick = 0;
  std::int64_t now_ns = 0;
  hal::ActuatorState sample;
  bool exchanged = true, deadline_missed = false, estop_pressed = false;
  std::int64_t brain_age_ns = -1;
  std::optional<wire::Command> command;
  std::optional<wire::Plan> plan;
  std::optional<wire::Inputs> inputs;
  const LitheLaw* law = nullptr;  // staged before this step
  law::Terms terms;
  std::array<std::int64_t, 16> times_ns{};  // the answers of the Host
  std::array<contain::Failure, 4> failures{};

  Input input() const {
    return {.tick = tick,
            .now_ns = now_ns,
            .sample = sample,
            .exchanged = exchanged,
            .deadline_missed = deadline_missed,
            .estop_pressed = estop_pressed,
            .brain_age_ns = brain_age_ns,
            .command = command ? &*command : nullptr,
            .plan = plan ? &*plan : nullptr,
            .inputs = inputs ? &*inputs : nullptr};
  }
};

// Answers as if every look at the clock took a microsecond. Every 7001st law runs too long. Notes its answers.
class LiveHost final : public Host {
 public:
  std::int64_t now_ns() LITHE_RT override {
    time_ns_ += 1000;
    if (looks_ < given_->times_ns.size()) given_->times_ns[looks_++] = time_ns_;
    return time_ns_;
  }
  contain::Failure run(law::Sandbox& sandbox, std::int64_t) LITHE_RT override {
    sandbox.call();
    const contain::Failure failure{++runs_ % 7001 == 0 ? wire::LawFaultKind::overran : wire::LawFaultKind::none, 0, 0};
    if (calls_ < given_->failures.size()) given_->failures[calls_++] = failure;
    return failure;
  }
  void note_in(Given& given) {
    given_ = &given;
    looks_ = calls_ = 0;
  }

 private:
  Given* given_ = nullptr;
  std::size_t looks_ = 0, calls_ = 0;
  std::int64_t time_ns_ = 0;
  std::uint64_t runs_ = 0;
};

// Gives the answers of another host again.
class ReplayHost final : public Host {
 public:
  explicit ReplayHost(const Given& given) : given_(given) {}
  std::int64_t now_ns() LITHE_RT override { return looks_ < given_.times_ns.size() ? given_.times_ns[looks_++] : 0; }
  contain::Failure run(law::Sandbox& sandbox, std::int64_t) LITHE_RT override {
    sandbox.call();
    return calls_ < given_.failures.size() ? given_.failures[calls_++] : contain::Failure{};
  }

 private:
  const Given& given_;
  std::size_t looks_ = 0, calls_ = 0;
};

// A step with its laws, and what it gave out last.
class Stepper {
 public:
  explicit Stepper(const robot::RobotConfig& robot) : step_(robot, slot_, **sandbox_) {}

  void run(const Given& given, Host& host) {
    if (given.law != nullptr) stage(*given.law, given.terms);
    report_ = &step_.run(given.input(), host, command_, record_);
  }
  Mode mode() const { return step_.mode(); }
  const hal::ActuatorCommand& command() const { return command_; }
  const Report& report() const { return *report_; }

  // "" or what differs: commands, record, events, faults, the law's State, the comparison of a shadow.
  std::string differs_from(const Stepper& other) const {
    if (!same_command(other.command_)) return "the command";
    if (std::memcmp(&record_, &other.record_, sizeof record_) != 0) return "the record";
    if (!same(report_->events(), other.report_->events())) return "the events";
    if (!same(report_->law_faults(), other.report_->law_faults())) return "the law faults";
    const wire::ShadowReport &shadow = step_.laws().shadow(), &its = other.step_.laws().shadow();
    if (std::memcmp(&shadow, &its, sizeof its) != 0) return "the shadow's report";
    const law::Resident *law = step_.laws().active(), *theirs = other.step_.laws().active();
    if ((law == nullptr) != (theirs == nullptr)) return "the law";
    if (law != nullptr && law->state != theirs->state) return "the law's State";
    return "";
  }

 private:
  template <class T>
  static bool same(std::span<const T> a, std::span<const T> b) {
    return a.size() == b.size() && (a.empty() || std::memcmp(a.data(), b.data(), a.size_bytes()) == 0);
  }
  bool same_command(const hal::ActuatorCommand& other) const {
    const auto same_bits = [](const auto& a, const auto& b) { return std::memcmp(&a, &b, sizeof a) == 0; };
    return command_.tick == other.tick && command_.joints == other.joints && command_.action == other.action &&
           command_.clear_faults == other.clear_faults && command_.reset_simulation == other.reset_simulation &&
           same_bits(command_.torque_nm, other.torque_nm) && same_bits(command_.position_rad, other.position_rad) &&
           same_bits(command_.velocity_rad_s, other.velocity_rad_s) && same_bits(command_.kp_nm_rad, other.kp_nm_rad) &&
           same_bits(command_.kd_nm_s_rad, other.kd_nm_s_rad) && same_bits(command_.max_torque_nm, other.max_torque_nm);
  }
  void stage(const LitheLaw& law, const law::Terms& terms) {
    while (slot_.collect_retired() != nullptr) {
    }
    const auto free = std::find_if(residents_.begin(), residents_.end(), [this](law::Resident& r) {
      bool used = &r == slot_.active();
      for (std::uint32_t n = 1; n <= slot_.depth(); ++n) used = used || &r == slot_.before(n);
      return !used;
    });
    law::reset_resident(*free, law);
    free->index = static_cast<std::uint32_t>(free - residents_.begin());
    free->request_id = free->law_id = ++laws_;
    free->terms = terms;
    if (slot_.active() != nullptr) law::plan_migrations(*free, *slot_.active());
    EXPECT_TRUE(slot_.offer(&*free));
  }

  Result<law::SandboxMemory> sandbox_ = law::SandboxMemory::make();
  law::Slot slot_;
  std::array<law::Resident, law::kResidents> residents_{};
  std::uint32_t laws_ = 0;
  ControlStep step_;
  hal::ActuatorCommand command_;
  wire::Telemetry record_{};
  const Report* report_ = nullptr;
};

// A Stepper that controls the simulated robot. What it is asked to do follows from the tick and its mode alone.
class Loop {
 public:
  Loop(const robot::RobotConfig& robot, const LitheLaw* twin)
      : robot_(robot), twin_(twin), stepper_(std::make_unique<Stepper>(robot)), actuators_(open(robot)) {
    for (int i = 0; i < 20; ++i) actuators_->cycle({}, state_, now_ns_ += period_ns_);  // they report their settings
    sent_.joints = static_cast<std::uint32_t>(robot.joints.size());
  }

  // One tick. The result holds until the next one.
  Given& tick() {
    now_ns_ += period_ns_;
    ++tick_;
    given_ = {};
    given_.tick = tick_;
    given_.now_ns = now_ns_ + 100;
    given_.exchanged = tick_ % 1013 != 0;  // now and then the bus is late
    given_.deadline_missed = tick_ % 2017 == 0;
    given_.brain_age_ns = tick_ % 9000 > 8000 ? 1'000'000'000 : 1'000'000;  // a Brain that pauses
    ask();
    plan();
    give_input();
    stage();
    host_.note_in(given_);
    given_.sample = state_;
    stepper_->run(given_, host_);
    if (given_.exchanged) actuators_->cycle(sent_, state_, now_ns_);
    sent_ = stepper_->command();
    for (const wire::Event& event : stepper_->report().events()) ++happened_[event.kind];
    moving_ += stepper_->mode() == Mode::active ? 1 : 0;
    return given_;
  }
  const Stepper& stepper() const { return *stepper_; }
  std::uint64_t happened(wire::EventKind kind) const { return happened_[static_cast<std::uint32_t>(kind)]; }
  double moving_share() const { return static_cast<double>(moving_) / static_cast<double>(tick_); }

 private:
  static std::unique_ptr<hal::Actuators> open(const robot::RobotConfig& robot) {
    auto actuators = hal::sim::open_actuators(robot);
    EXPECT_TRUE(actuators);
    return std::move(*actuators);
  }
  void ask() {
    given_.estop_pressed = tick_ % 20'000 >= 19'990;
    if (tick_ % 50 != 0) return;
    wire::Command command{};
    command.request_id = tick_;
    CommandKind kind = CommandKind::none;
    const Mode mode = stepper_->mode();
    if (mode == Mode::safe_stop || mode == Mode::estop) kind = CommandKind::reset;
    if (mode == Mode::disarmed && tick_ >= 500) kind = CommandKind::arm;
    if (mode == Mode::active && tick_ % 2500 == 0) kind = CommandKind::set_params;
    if (mode == Mode::active && tick_ % 11'000 == 0) kind = CommandKind::rollback;
    if (kind == CommandKind::none) return;
    command.kind = static_cast<std::uint32_t>(kind);
    command.count = 1;
    command.value[0] = 3.0 + static_cast<double>(tick_ % 3000) / 3000;
    given_.command = command;
  }
  // The next 320 ms of a sine on every joint, every 20 ms; now and then none for a while. Every second time, for four
  // seconds, they are held.
  void plan() {
    if (tick_ % 20 != 7 || tick_ % 4000 > 3500) return;
    wire::Plan& plan = given_.plan.emplace();
    plan.plan_id = tick_;
    plan.waypoint_count = wire::kNw;
    plan.joint_count = static_cast<std::uint32_t>(robot_.joints.size());
    plan.streaming = 1;
    if (tick_ / 4000 % 2 == 1) plan.interpolation = static_cast<std::uint32_t>(wire::Interpolation::hold);
    for (std::size_t w = 0; w < wire::kNw; ++w) {
      plan.t_ns[w] = now_ns_ + static_cast<std::int64_t>(w) * 20 * kNsPerMs;
      for (std::size_t j = 0; j < robot_.joints.size(); ++j) {
        plan.position_rad[w * wire::kNj + j] = 0.2 + 0.15 * std::sin(3e-9 * static_cast<double>(plan.t_ns[w]));
        plan.velocity_rad_s[w * wire::kNj + j] = kNoTarget;
      }
    }
  }
  // A new value every 30 ms; now and then one out of range.
  void give_input() {
    if (tick_ % 30 != 11) return;
    given_.inputs.emplace().count = 1;
    given_.inputs->value[0] = 0.12 * std::sin(static_cast<double>(tick_));
  }
  // A law every 800 ms: blended, on probation, some from the shadow, some bad.
  void stage() {
    if (tick_ % 800 != 1) return;
    const std::uint64_t turn = tick_ / 800;
    given_.law = turn % 5 == 3 ? &kLateNan : turn % 2 == 0 ? &kSoft : &kInTheDrive;
    if (twin_ != nullptr && turn == 1) given_.law = twin_;
    given_.terms.blend_ticks = 20;
    given_.terms.probation_ticks = 300;
    if (turn % 7 == 4) given_.terms.shadow_ticks = 100;
  }

  const robot::RobotConfig& robot_;
  const LitheLaw* twin_;
  std::int64_t period_ns_ = std::llround(1e9 / robot_.rate_hz);
  std::unique_ptr<Stepper> stepper_;
  std::unique_ptr<hal::Actuators> actuators_;
  LiveHost host_;
  Given given_;
  hal::ActuatorState state_;
  hal::ActuatorCommand sent_;
  std::uint64_t tick_ = 0, moving_ = 0;
  std::int64_t now_ns_ = 1000 * kNsPerS;
  std::array<std::uint64_t, 64> happened_{};
};

}  // namespace lithe::step
