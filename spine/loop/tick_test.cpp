// SPDX-License-Identifier: Apache-2.0
// The tick with every real part around it: robot file, guard, plan, slot, moteus frames, simulated joint. The test
// plays the Transport, and time is virtual: no test here depends on how fast the machine is.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <memory>
#include <random>

#include "spine/core/no_alloc/no_alloc.hpp"
#include "spine/loop/spine.hpp"
#include "spine/robot/robot.hpp"

namespace lithe::loop {
namespace {

using wire::CommandKind;
using wire::CommandResult;
using wire::Mode;

constexpr char kRobot[] = R"(
name = "probe"
rate_hz = 1000
[spine]
late_ticks_to_stop = 5
[brain]
stale_after_s = 0.1
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
[joint.sim]
inertia_kg_m2 = 2.5e-3
mgl_nm = 0.165
coulomb_nm = 0.01
torque_lag_s = 0.001
)";
constexpr double kSlewPerTickNm = 120.0 / 1000.0;

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
struct Push {  // as far from Pd as it gets
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

constexpr LitheLaw kPd = describe<Pd>("pd");
constexpr LitheLaw kPush = describe<Push>("push");
constexpr LitheLaw kNotFinite = describe<NotFinite>("not_finite");

class TickTest : public testing::Test {
 protected:
  TickTest() : robot_(*robot::parse_robot(kRobot, "probe.toml")) {
    start_clock(clock_);
    actuators_ = std::move(*hal::open_actuators(robot_));
    spine_ = std::make_unique<Spine>(
        Wiring{robot_, *memory_, *control_memory_, *brain_memory_, slot_, handover_, clock_, nullptr});
    command_ = std::make_unique<ipc::MailboxSender<wire::Command, 16>>(control_memory_->commands, memory_->control_ack);
  }

  // One period: the tick, then the Transport, unless it is to be late.
  void tick(bool transport_in_time = true, std::uint32_t skipped = 0) {
    now_ns_ += kNsPerMs * (1 + skipped);
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
    law::Resident& resident = residents_[next_++ % residents_.size()];
    law::reset_resident(resident, law);
    resident.index = (next_ - 1) % law::kResidents;
    resident.law_id = next_;
    if (slot_.active() != nullptr) law::build_bridge(resident, 0, *slot_.active()->descriptor, slot_.active()->law_id);
    EXPECT_TRUE(slot_.offer(&resident));
    while (slot_.collect_retired() != nullptr) {
    }
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

  void arm_with(const LitheLaw& law) {
    stage(law);
    ticks(3);
    ASSERT_EQ(send(CommandKind::arm), CommandResult::done);
    ticks(10);  // the drive enables
  }

  // A plan to `goal_rad` in 300 ms, resting there, and a sign of life.
  void publish(double goal_rad) {
    wire::Plan plan;
    plan.plan_id = ++plan_id_;
    plan.waypoint_count = 1;
    plan.joint_count = 1;
    plan.t_ns[0] = now_ns_ + 300 * kNsPerMs;
    plan.position_rad[0] = goal_rad;
    plan.velocity_rad_s[0] = std::numeric_limits<double>::quiet_NaN();
    ipc::ChannelWriter<wire::Plan>(brain_memory_->plan).write(plan);
    brain_memory_->header.heartbeat_ns = now_ns_;
  }

  Mode mode() const { return static_cast<Mode>(record_.mode); }

  robot::RobotConfig robot_;
  std::unique_ptr<ipc::SpineMemory> memory_ = std::make_unique<ipc::SpineMemory>();
  std::unique_ptr<ipc::ControlMemory> control_memory_ = std::make_unique<ipc::ControlMemory>();
  std::unique_ptr<ipc::BrainMemory> brain_memory_ = std::make_unique<ipc::BrainMemory>();
  ClockMemory clock_{};
  Handover handover_;
  law::Slot slot_;
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

TEST_F(TickTest, DrivesAreOffUntilSomebodyArms) {
  stage(kPd);
  ticks(20);
  EXPECT_EQ(mode(), Mode::disarmed);
  EXPECT_EQ(sent_.action, hal::DriveAction::off);
  EXPECT_EQ(record_.joint_status[0] >> 16, 0u) << "the drive itself says: stopped";
}

TEST_F(TickTest, AnArmedLawTracksThePlan) {
  arm_with(kPd);
  publish(0.5);
  for (int i = 0; i < 600; ++i) {
    brain_memory_->header.heartbeat_ns = now_ns_;
    tick();
  }
  EXPECT_EQ(mode(), Mode::active);
  EXPECT_EQ(record_.plan_id, 1u);
  EXPECT_NEAR(record_.setpoint_position_rad[0], 0.5, 1e-9);
  EXPECT_NEAR(record_.position_rad[0], 0.5, 0.05);
}

TEST_F(TickTest, TheCommandOfATickLeavesAtTheNextRelease) {
  arm_with(kPush);
  const std::uint64_t computed_in = record_.tick;
  const double torque_nm = record_.command_torque_nm[0];
  tick();
  EXPECT_EQ(sent_.tick, computed_in + 1);
  EXPECT_DOUBLE_EQ(sent_.torque_nm[0], torque_nm);
}

TEST_F(TickTest, ALawThatIsNotFiniteIsReplacedInTheSameTick) {
  arm_with(kPd);
  stage(kNotFinite);
  tick();  // commits at its end
  EXPECT_EQ(mode(), Mode::active);
  tick();  // the first and last tick of the bad law
  EXPECT_EQ(mode(), Mode::safe_stop);
  EXPECT_EQ(static_cast<wire::Fault>(record_.fault), wire::Fault::law_not_finite);
  for (int i = 0; i < 500; ++i) {
    tick();
    ASSERT_TRUE(std::isfinite(sent_.torque_nm[0]));
    ASSERT_LE(std::abs(sent_.torque_nm[0]), 0.6);
  }
  EXPECT_EQ(send(CommandKind::arm), CommandResult::refused_fault);
}

TEST_F(TickTest, NoSwapEverMovesTheTorqueFasterThanTheSlewBound) {
  arm_with(kPd);
  double last_nm = record_.command_torque_nm[0];
  for (int i = 0; i < 400; ++i) {
    if (i % 5 == 0) stage(i % 10 == 0 ? kPush : kPd);
    tick();
    ASSERT_EQ(mode() == Mode::active || mode() == Mode::safe_stop, true);
    ASSERT_LE(std::abs(record_.command_torque_nm[0] - last_nm), kSlewPerTickNm + 1e-9) << "tick " << i;
    last_nm = record_.command_torque_nm[0];
  }
}

TEST_F(TickTest, StateIsCarriedIntoTheNextLawByName) {
  arm_with(kPd);
  publish(0.5);
  ticks(50);
  const double before = reinterpret_cast<const Pd::State*>(slot_.active()->state.data())->integral_rad_s;
  ASSERT_NE(before, 0.0);
  stage(kPush);
  tick();
  const double after = reinterpret_cast<const Push::State*>(slot_.active()->state.data())->integral_rad_s;
  EXPECT_NE(after, 1.0) << "the default of the new law would be 1.0";
  EXPECT_NEAR(after, before, 0.01);
}

TEST_F(TickTest, RollbackBringsThePreviousLawBack) {
  arm_with(kPd);
  stage(kPush);
  ticks(2);
  EXPECT_EQ(send(CommandKind::rollback), CommandResult::done);
  tick();
  EXPECT_EQ(record_.law_id, 1u);
  EXPECT_EQ(send(CommandKind::rollback), CommandResult::refused_law) << "there is only one way back";
}

TEST_F(TickTest, ParametersChangeAllOrNone) {
  arm_with(kPd);
  wire::Command command;
  command.kind = static_cast<std::uint32_t>(CommandKind::set_params);
  command.count = 2;
  command.index = {0, 1};
  command.value[0] = 8.0;
  command.value[1] = 99.0;  // above its maximum
  EXPECT_EQ(send(command), CommandResult::refused_range);
  EXPECT_EQ(slot_.active()->params[0].value, 4.0);
  command.value[1] = 0.3;
  EXPECT_EQ(send(command), CommandResult::done);
  EXPECT_EQ(slot_.active()->params[0].value, 8.0);
  EXPECT_EQ(slot_.active()->params[1].value, 0.3);
}

TEST_F(TickTest, ALateTransportIsCountedAndStopsTheRobotWhenItStaysLate) {
  arm_with(kPd);
  const std::uint32_t before = record_.late_samples;
  for (int i = 0; i < 3; ++i) tick(false);  // the first of these still finds the exchange before done
  EXPECT_EQ(record_.late_samples, before + 2);
  EXPECT_EQ(mode(), Mode::active);
  serve();
  ticks(3);
  EXPECT_EQ(mode(), Mode::active) << "a short delay is survived";
  for (int i = 0; i < 8; ++i) tick(false);
  EXPECT_EQ(mode(), Mode::safe_stop);
  EXPECT_EQ(static_cast<wire::Fault>(record_.fault), wire::Fault::sample_stale);
}

TEST_F(TickTest, SkippedReleasesAreCounted) {
  arm_with(kPd);
  tick(true, 3);
  EXPECT_EQ(record_.missed_releases, 3u);
  EXPECT_NE(record_.flags & wire::telemetry_flag::kDeadlineMissed, 0u);
  tick();
  EXPECT_EQ(record_.flags & wire::telemetry_flag::kDeadlineMissed, 0u);
}

TEST_F(TickTest, EitherEstopWordStopsTheDrivesAndStaysUntilReleasedAndReset) {
  for (std::uint64_t* word : {&control_memory_->estop.value, &brain_memory_->estop.value}) {
    if (mode() != Mode::active) arm_with(kPd);
    *word = 1;
    ticks(2);
    EXPECT_EQ(mode(), Mode::estop);
    EXPECT_EQ(sent_.action, hal::DriveAction::damp);
    EXPECT_EQ(send(CommandKind::reset), CommandResult::refused_estop);
    *word = 0;
    ticks(5);
    EXPECT_EQ(mode(), Mode::estop) << "letting go is not a reset";
    EXPECT_EQ(send(CommandKind::reset), CommandResult::done);
    EXPECT_EQ(mode(), Mode::disarmed);
  }
}

TEST_F(TickTest, ASilentBrainLeavesTheJointAtRestWhereItIs) {
  arm_with(kPd);
  publish(0.5);
  ticks(150);  // in full flight; nothing more ever comes from the Brain
  ticks(1000);
  EXPECT_EQ(mode(), Mode::active);
  EXPECT_NE(record_.flags & wire::telemetry_flag::kBrainStale, 0u);
  EXPECT_EQ(record_.setpoint_velocity_rad_s[0], 0.0);
}

TEST_F(TickTest, HostileBytesNeverLeaveTheLimits) {
  arm_with(kPd);
  std::mt19937_64 random(7);
  for (int i = 0; i < 3000; ++i) {
    auto* bytes = reinterpret_cast<unsigned char*>(brain_memory_.get());
    for (int k = 0; k < 64; ++k)
      bytes[random() % (sizeof(ipc::BrainMemory) - sizeof(ipc::StickyWord))] = random() & 0xff;
    tick();
    ASSERT_TRUE(std::isfinite(sent_.torque_nm[0]));
    ASSERT_LE(std::abs(sent_.torque_nm[0]), 0.6);
    ASSERT_TRUE(std::isfinite(record_.setpoint_position_rad[0]));
    ASSERT_LE(std::abs(record_.setpoint_position_rad[0]), 3.0);
  }
}

TEST_F(TickTest, NothingIsAllocatedWhateverHappens) {
  arm_with(kPd);
  const NoAllocScope scope;
  for (int i = 0; i < 1000; ++i) {
    if (i % 100 == 0) publish(i % 200 == 0 ? 0.4 : -0.4);
    if (i == 300) stage(kPush);
    if (i == 400) send(CommandKind::rollback);
    if (i == 500) control_memory_->estop.value = 1;
    tick(i % 97 != 0, i % 89 == 0 ? 2 : 0);
    serve();
  }
  EXPECT_EQ(scope.calls(), 0u);
}

}  // namespace
}  // namespace lithe::loop
