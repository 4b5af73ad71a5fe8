// SPDX-License-Identifier: Apache-2.0
#include "tests/faults/rig.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <map>
#include <numbers>
#include <utility>

#include "spine/hal/robot_hardware.hpp"

namespace lithe::faults {
namespace {

using simulator::FaultRequest;
using wire::CommandKind;
using wire::CommandResult;

constexpr int kToBoot = 400;
constexpr int kToSettle = 200;
constexpr int kOfFault = 1500;
constexpr int kAfterFault = 600;
constexpr int kMostToBrake = 4000;  // more than the 3 s that a reset brakes at most
constexpr int kStallTicks = 250;

// Stays where it is, and always wants more than it may have.
struct Restless {
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    const double shake_nm = 5 * std::sin(2 * std::numbers::pi * 50 * t.t_s);
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      const double error_rad = t.setpoint_position_rad[j] - t.position_rad[j];
      u.torque_nm[j] = 8 * error_rad - 0.2 * t.velocity_rad_s[j] + shake_nm;
    }
  }
};
constexpr LitheLaw kRestless = describe<Restless>("restless");

robot::RobotConfig robot_for(const Cell& cell, void (*change)(robot::RobotConfig&)) {
  Result<robot::RobotConfig> robot = robot::load_robot(LITHE_FAULTS "/robot.toml");
  EXPECT_TRUE(robot) << robot.message();
  if (cell.others_stop) robot->guard.other_groups = robot::OtherGroups::stop;
  if (change != nullptr) change(*robot);
  return *robot;
}

// The robot's buses end at the wires of these devices.
class AtWires final : public hal::Simulation {
 public:
  explicit AtWires(simulator::Devices& devices) : devices_(devices) {}
  std::unique_ptr<hal::Bus> open_bus(const robot::RobotConfig& /*robot*/, std::size_t index) override {
    auto bus = std::make_unique<hal::LoopBus>();
    bus->attach(devices_.wire(index));
    return bus;
  }
  hal::ImuSource& imu() override { std::abort(); }  // the robot has none
  void to_start() LITHE_RT override {}

 private:
  simulator::Devices& devices_;
};

std::unique_ptr<hal::Actuators> at_wires(robot::RobotConfig robot, simulator::Devices& devices) {
  for (robot::BusConfig& bus : robot.buses) bus.kind = robot::BusKind::loop;
  const auto make = [&devices](const robot::RobotConfig&) -> Result<std::unique_ptr<hal::Simulation>> {
    return std::unique_ptr<hal::Simulation>(std::make_unique<AtWires>(devices));
  };
  return std::move(*hal::open_actuators(robot, {.make_simulation = make}));
}

// The rungs in the order in which they were reached.
class Ladder {
 public:
  void see(wire::Rung rung) {
    if (rung == last_) return;
    last_ = rung;
    text_ += (text_.empty() ? "" : " ") + std::string(wire::to_string(rung));
  }
  std::string text() const { return text_.empty() ? "law" : text_; }

 private:
  wire::Rung last_ = wire::Rung::law;
  std::string text_;
};

class Rig : private loop::TickBench {
 public:
  Rig(const Cell& cell, const robot::RobotConfig& robot, simulator::Devices& devices)
      : TickBench(robot, at_wires(robot, devices)),
        cell_(cell),
        devices_(devices),
        target_(cell.kind == "cia402" ? 2 : 0),
        friend_(target_ + 1) {
    for (const robot::DeviceConfig& device : robot.devices) slowest_ = std::max(slowest_, device.rate_divider);
  }

  Outcome run() {
    stage(kRestless);
    if (cell_.before_arming) strike();
    pass_turns(kToBoot);
    out_.armed = wire::to_string(send(CommandKind::arm));
    if (!cell_.before_arming) suffer();
    clear();
    pass_turns(kAfterFault);
    out_.latched = nothing_was_undone();
    if (record_.fault != 0) send(CommandKind::reset);
    for (int i = 0; i < kMostToBrake && mode() == loop::Mode::safe_stop; ++i) pass_turns(1);  // a reset brakes first
    pass_turns(kAfterFault);
    if (mode() == loop::Mode::disarmed) send(CommandKind::arm);
    pass_turns(kToSettle);
    out_.recovered = mode() == loop::Mode::active && record_.fault == 0 && rung(target_) == wire::Rung::law &&
                     record_.joint_fault[target_] == 0 && std::isfinite(record_.sensor[0]);
    return out_;
  }

 private:
  using Counts = std::map<std::string, std::uint64_t>;

  wire::Rung rung(std::size_t j) const { return static_cast<wire::Rung>(record_.joint_rung[j]); }
  std::uint32_t joints() const { return static_cast<std::uint32_t>(robot_.joints.size()); }
  bool is_friend(std::size_t j) const { return robot_.joints[j].group == robot_.joints[target_].group; }

  void suffer() {
    pass_turns(kToSettle);
    const Counts before = counts();
    std::vector<Ladder> ladders(joints());
    strike();
    for (int i = 1; i <= kOfFault * static_cast<int>(slowest_); ++i) {
      pass(1);
      for (std::uint32_t j = 0; j < joints(); ++j) ladders[j].see(rung(j));
      if (out_.ticks == 0 && rung(target_) != wire::Rung::law) out_.ticks = i;
    }
    tell(ladders);
    for (const auto& [name, count] : counts())
      if (count > before.at(name)) out_.counted += (out_.counted.empty() ? "" : " ") + name;
  }

  void strike() {
    if (cell_.order.empty()) return tick(true, kStallTicks);
    Result<FaultRequest> order = simulator::parse_order(cell_.order);
    ASSERT_TRUE(order) << order.message();
    // For those behind it, an adapter that is gone is a wire that carries nothing.
    if (order->kind == FaultRequest::Kind::unplug) order->kind = FaultRequest::Kind::bus_off;
    const std::string device = cell_.kind == "moteus" ? "m1" : cell_.kind == "cia402" ? "c1" : "inputs";
    (simulator::is_of_device(order->kind) ? order->device : order->bus) =
        simulator::is_of_device(order->kind) ? device : "bus_" + device;
    const Result<> known = devices_.check(*order);
    ASSERT_TRUE(known) << known.message();
    devices_.act(*order, now_ns_);
  }
  void clear() {
    FaultRequest order;
    order.kind = FaultRequest::Kind::clear;
    devices_.act(order, now_ns_);
  }

  void tell(const std::vector<Ladder>& ladders) {
    out_.fault = wire::to_string(static_cast<wire::Fault>(record_.fault));
    out_.joint_fault = wire::to_string(static_cast<wire::Fault>(record_.joint_fault[target_]));
    out_.ladder = ladders[target_].text();
    out_.group = ladders[friend_].text();
    for (std::uint32_t j = 0; j < joints(); ++j) {
      if (is_friend(j)) continue;
      const std::string text = ladders[j].text();
      out_.others = out_.others.empty() || out_.others == text ? text : "?";
    }
    out_.sensor = std::isfinite(record_.sensor[0]) ? "valid" : "lost";
    out_.named = named_;
    then_ = record_;
  }
  void hear() {
    wire::Event event;
    while (events_.next(event)) {
      const std::string text(event.text.data());
      if (text.ends_with(" at joint " + robot_.joints[target_].name + ", group " + robot_.joints[target_].group))
        named_ = text;
    }
  }

  // A joint that is heard of again may go on to the last rung, and none goes back up.
  bool nothing_was_undone() const {
    if (cell_.before_arming) return true;
    bool same = record_.fault == then_.fault && record_.mode == then_.mode;
    for (std::uint32_t j = 0; j < joints(); ++j)
      same = same && record_.joint_rung[j] >= then_.joint_rung[j] && record_.joint_fault[j] == then_.joint_fault[j];
    return same;
  }

  Counts counts() const {
    const hal::ReplyCounters& c = actuators_->counters();
    return {{"missed", c.missed},           {"late", c.late},      {"duplicate", c.duplicate},
            {"conflicting", c.conflicting}, {"stray", c.stray},    {"malformed", c.malformed},
            {"unsound", c.unsound},         {"refused", c.refused}};
  }

  // So many turns of the drives that are asked least often.
  void pass_turns(int count) { pass(count * static_cast<int>(slowest_)); }
  void pass(int count) {
    for (int i = 0; i < count; ++i) {
      const hal::ActuatorCommand before = sent_;
      before_ = record_;
      tick();
      hear();
      for (std::uint32_t j = 0; j < joints(); ++j) check(before, j);
    }
  }
  // What left in this tick was decided in the one before.
  hal::DriveAction action_of(std::uint32_t j) const {
    const auto rung = static_cast<wire::Rung>(before_.joint_rung[j]);
    const bool off = static_cast<loop::Mode>(before_.mode) == loop::Mode::disarmed || rung == wire::Rung::off;
    if (off) return hal::DriveAction::off;
    return rung == wire::Rung::brake ? hal::DriveAction::brake : hal::DriveAction::torque;
  }
  // Whatever leaves is within the joint's limits, and what its rung says.
  void check(const hal::ActuatorCommand& before, std::uint32_t j) {
    const robot::JointConfig& limit = robot_.joints[j];
    const double torque_nm = sent_.torque_nm[j];
    const bool driven = sent_.action[j] == hal::DriveAction::torque;
    std::string what;
    if (!std::isfinite(torque_nm) || !std::isfinite(sent_.kd_nm_s_rad[j])) what = "not finite";
    if (std::abs(torque_nm) > limit.torque_max_nm + 1e-9) what = "torque";
    if (sent_.max_torque_nm[j] > limit.torque_max_nm) what = "the drive's own limit";
    if (sent_.action[j] != action_of(j)) what = "what its rung allows";
    if (!driven && torque_nm != 0) what = "torque without a law";
    const double step_nm = std::abs(torque_nm - before.torque_nm[j]);
    const bool goes_on = driven && before.action[j] == hal::DriveAction::torque;
    if (goes_on && step_nm > limit.torque_slew_nm_s / robot_.rate_hz + 1e-9) what = "slew";
    if (!what.empty() && out_.broken.empty()) out_.broken = what + " of " + limit.name;
  }

  const Cell& cell_;
  simulator::Devices& devices_;
  std::size_t target_, friend_;
  std::uint32_t slowest_ = 1;
  Outcome out_;
  wire::Telemetry then_;    // when the fault ended
  wire::Telemetry before_;  // of the tick before
  std::string named_;
  ipc::RingReader<wire::Event, wire::spine_segment::kEventsTickDepth> events_{memory_->events_tick};
};

}  // namespace

Outcome run(const Cell& cell, void (*change)(robot::RobotConfig&)) {
  const robot::RobotConfig robot = robot_for(cell, change);
  return Rig(cell, robot, **simulator::Devices::make(robot, 1)).run();
}

}  // namespace lithe::faults
