// SPDX-License-Identifier: Apache-2.0
// The tick with every real part around it: robot file, guard, plan, slot, moteus frames, simulated joint. The test does
// the Transport's work, and time is virtual: the tests do not depend on the speed of the machine.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <limits>
#include <memory>

#include "spine/hal/sim/simulate.hpp"
#include "spine/loop/spine.hpp"
#include "spine/robot/robot.hpp"

namespace lithe::loop {

using wire::CommandKind;
using wire::CommandResult;
using wire::Mode;

inline constexpr char kRobot[] = R"(
name = "probe"
rate_hz = 1000
[spine]
late_ticks_to_stop = 5
[brain]
stale_after_s = 0.1
[guard]
soft_start_s = 0.0
[[bus]]
name = "can0"
kind = "loop"
[[device]]
name = "drive"
kind = "moteus"
bus = "can0"
id = 1
watchdog_s = 0.1
[[joint]]
name = "shoulder"
device = "drive"
position_min_rad = -3.0
position_max_rad = 3.0
velocity_max_rad_s = 30.0
torque_max_nm = 0.6
torque_slew_nm_s = 120.0
deceleration_rad_s2 = 20.0
safe_kd_nm_s_rad = 0.05
[[input]]
name = "push_nm"
min = -0.5
max = 0.25
[joint.sim]
inertia_kg_m2 = 2.5e-3
mgl_nm = 0.165
coulomb_nm = 0.01
torque_lag_s = 0.001
)";
inline constexpr double kSlewPerTickNm = 120.0 / 1000.0;

struct Pd {
  struct Params {
    Param kp_nm_rad{4.0, 0.0, 40.0};
    Param kd_nm_s_rad{0.1, 0.0, 4.0};
  };
  struct State {
    double integral_rad_s = 0;
  };
  static void step(const Tick& t, const Params& p, State& s, Effort& u) {
    const double error_rad = t.setpoint_position_rad[0] - t.position_rad[0];
    s.integral_rad_s += error_rad * t.dt_s;
    u.torque_nm[0] = p.kp_nm_rad * error_rad - p.kd_nm_s_rad * t.velocity_rad_s[0];
  }
};
struct Push {  // differs from Pd as much as possible
  struct Params {};
  struct State {
    double integral_rad_s = 1.0;
  };
  static void step(const Tick&, const Params&, State&, Effort& u) { u.torque_nm[0] = -1000.0; }
};
struct NotFinite {
  struct Params {};
  struct State {};
  static void step(const Tick&, const Params&, State&, Effort& u) {
    u.torque_nm[0] = std::numeric_limits<double>::quiet_NaN();
  }
};

inline constexpr LitheLaw kPd = describe<Pd>("pd");
inline constexpr LitheLaw kPush = describe<Push>("push");
inline constexpr LitheLaw kNotFinite = describe<NotFinite>("not_finite");

class TickBench {
 public:
  explicit TickBench(const robot::RobotConfig& robot) : TickBench(robot, std::move(*hal::sim::open_actuators(robot))) {}
  TickBench(const robot::RobotConfig& robot, std::unique_ptr<hal::Actuators> actuators)
      : robot_(robot), actuators_(std::move(actuators)) {
    start_clock(clock_);
    hal::ActuatorState unseen;  // while the drives report their settings
    for (int i = 0; i < 20; ++i) actuators_->cycle({}, unseen, now_ns_ += period_ns_);
    use_cell(nullptr);
    command_ = std::make_unique<ipc::MailboxSender<wire::Command, 16>>(control_memory_->commands, memory_->control_ack);
  }

  // A new Spine, as after a start; with a FaultBarrier it survives laws that crash.
  void use_cell(contain::FaultBarrier* barrier) {
    spine_ = std::make_unique<Spine>(Wiring{robot_, *memory_, *control_memory_, *brain_memory_, slot_, **sandbox_,
                                            barrier, handover_, clock_, nullptr, nullptr, &supervised_});
  }

  // One period: the tick, then the Transport, unless the test makes it late.
  void tick(bool transport_in_time = true, std::uint32_t skipped = 0) {
    now_ns_ += period_ns_ * (1 + skipped);
    spine_->tick(now_ns_, now_ns_ + 100, skipped);
    if (transport_in_time) serve();
    reader_.latest(record_);
  }
  void serve() {
    if (!handover_.pending()) return;
    sent_ = handover_.command();
    actuators_->cycle(sent_, handover_.sample(), now_ns_);
    handover_.finish();
  }
  void ticks(int count) {
    for (int i = 0; i < count; ++i) tick();
  }

  law::Resident& stage(const LitheLaw& law) {
    while (slot_.collect_retired() != nullptr) {
    }
    const auto free = std::find_if(residents_.begin(), residents_.end(), [this](law::Resident& r) {
      bool used = &r == slot_.active();
      for (std::uint32_t n = 1; n <= slot_.depth(); ++n) used = used || &r == slot_.before(n);
      return !used;
    });
    law::Resident& resident = *free;
    law::reset_resident(resident, law);
    resident.index = static_cast<std::uint32_t>(free - residents_.begin());
    resident.law_id = ++next_;
    resident.request_id = next_;
    resident.terms = terms_;
    if (slot_.active() != nullptr) law::plan_migrations(resident, *slot_.active());
    EXPECT_TRUE(slot_.offer(&resident));
    return resident;
  }

  CommandResult send(wire::Command command) {
    const auto ticket = command_->send(command);
    EXPECT_TRUE(ticket);
    tick();
    return static_cast<CommandResult>(command_->poll(*ticket));
  }
  CommandResult send(CommandKind kind) {
    wire::Command command;
    command.kind = static_cast<std::uint32_t>(kind);
    return send(command);
  }

  // `disarm` or `reset`, until a joint that moved has been braked and the drives are off, as the supervisor waits.
  CommandResult send_off(CommandKind kind) {
    const CommandResult result = send(kind);
    for (int left = static_cast<int>(4 * robot_.rate_hz); left > 0 && mode() == Mode::safe_stop; --left) tick();
    return result;
  }
  CommandResult arm_all_the_same() {  // also a law that has stopped the robot
    wire::Command command;
    command.kind = static_cast<std::uint32_t>(CommandKind::arm);
    command.count = 1;
    return send(command);
  }

  void arm_with(const LitheLaw& law) {
    stage(law);
    ticks(3);
    ASSERT_EQ(send(CommandKind::arm), CommandResult::done);
    ticks(10);  // the drive enables
  }

  // Publishes a plan that ends at rest at `goal_rad`, and a heartbeat.
  void publish(double goal_rad, std::int64_t in_ms = 300, wire::Interpolation how = wire::Interpolation::cubic) {
    wire::Plan plan;
    plan.plan_id = ++plan_id_;
    plan.waypoint_count = 1;
    plan.joint_count = 1;
    plan.interpolation = static_cast<std::uint32_t>(how);
    plan.t_ns[0] = now_ns_ + in_ms * kNsPerMs;
    plan.position_rad[0] = goal_rad;
    plan.velocity_rad_s[0] = std::numeric_limits<double>::quiet_NaN();
    ipc::ChannelWriter<wire::Plan>(brain_memory_->plan).write(plan);
    brain_memory_->header.heartbeat_ns = now_ns_;
  }

  Mode mode() const { return static_cast<Mode>(record_.mode); }

 protected:
  robot::RobotConfig robot_;
  std::int64_t period_ns_ = std::llround(1e9 / robot_.rate_hz);
  std::unique_ptr<ipc::SpineMemory> memory_ = std::make_unique<ipc::SpineMemory>();
  std::unique_ptr<ipc::ControlMemory> control_memory_ = std::make_unique<ipc::ControlMemory>();
  std::unique_ptr<ipc::BrainMemory> brain_memory_ = std::make_unique<ipc::BrainMemory>();
  ClockMemory clock_{};
  std::atomic<bool> supervised_{false};
  Handover handover_;
  law::Slot slot_;
  Result<law::SandboxMemory> sandbox_ = law::SandboxMemory::make();
  law::Terms terms_;  // of the next law staged
  std::unique_ptr<hal::Actuators> actuators_;
  std::unique_ptr<Spine> spine_;
  std::unique_ptr<ipc::MailboxSender<wire::Command, 16>> command_;
  ipc::RingReader<wire::Telemetry, wire::spine_segment::kTelemetryDepth> reader_{memory_->telemetry};
  std::array<law::Resident, law::kResidents> residents_{};
  std::uint32_t next_ = 0;
  std::uint64_t plan_id_ = 0;
  std::int64_t now_ns_ = 1000 * kNsPerS;
  hal::ActuatorCommand sent_;
  wire::Telemetry record_;
};

class TickTest : public testing::Test, protected TickBench {
 protected:
  TickTest() : TickBench(*robot::parse_robot(kRobot, "probe.toml")) {}
};

}  // namespace lithe::loop
