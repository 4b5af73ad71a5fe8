// SPDX-License-Identifier: Apache-2.0
// The time of an exchange and a tick with 1, 4, 12 and 32 joints: moteus frames on a bus in memory, simulated drives.
//
// "exchange": commands out and answers matched, without pauses and without simulated time: the drives read every
// command and write every answer, but compute no physics. "simulated": the same with a millisecond of physics each,
// with moving joints. The floor is an exchange without joints. Subjects take turns in short blocks. "transport" and
// "tick" are from a whole Spine at 1 kHz, in blocks of half a second: the time of its Transport thread and of its tick
// without the law, in each period. The negative control compares 32 joints with one; they must differ. argv: rounds of
// the exchanges, rounds of the Spines; or "cost": only the ticks of whole Spines, on the robot files with 1, 8 and 32
// joints.
#include <algorithm>
#include <array>
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include "bench/rig/cycles.hpp"
#include "bench/rig/machine.hpp"
#include "bench/rig/samples.hpp"
#include "bench/rig/spine_rig.hpp"
#include "spine/core/host/realtime.hpp"
#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/bus_actuators.hpp"
#include "spine/hal/sim/simulate.hpp"
#include "spine/robot/robot.hpp"

namespace lithe::bench {
namespace {

constexpr int kExchanges = 500;  // in a block
constexpr int kWarmUp = 20;      // more, before those that count: another subject had the caches
constexpr std::int64_t kBlockNs = 500 * kNsPerMs;
constexpr int kCostRounds = 8;
constexpr double kControlAtLeast = 4, kCostControlAtLeast = 1.3;
constexpr std::int64_t kTickNs = kNsPerMs;
constexpr std::uint64_t kPushTicks = 200;

robot::RobotConfig robot_of(std::size_t joints) {
  auto config = or_exit(robot::load_robot(LITHE_ROBOTS "/arm32.toml"));
  if (config.joints.size() < joints) give_up("robots/arm32.toml has too few joints");
  config.joints.resize(joints);
  config.devices.resize(joints);
  for (robot::JointConfig& joint : config.joints) joint.sim.initial_position_rad = 1;
  return config;
}

std::unique_ptr<hal::Actuators> open(std::size_t joints) {
  if (joints == 0) {
    auto none = std::make_unique<hal::BusActuators>(RawClock::calibrate());
    none->add_bus(std::make_unique<hal::LoopBus>(), nullptr);
    return none;
  }
  return or_exit(hal::sim::open_actuators(robot_of(joints)));
}

// One robot's exchanges.
class Subject {
 public:
  Subject(std::size_t joints, bool time_passes)
      : key_(joints == 0 ? "exchange_empty"
                         : (time_passes ? "simulated_" : "exchange_") + std::to_string(joints) + "j"),
        joints_(joints),
        step_ns_(time_passes ? kTickNs : 0),
        actuators_(open(joints)) {
    command_.joints = static_cast<std::uint32_t>(joints);
    command_.position_rad.fill(kNoTarget);
    command_.max_torque_nm.fill(0.5);
    command_.kd_nm_s_rad.fill(0.01);
    command_.action.fill(hal::DriveAction::torque);
    for (int i = 0; i < 50; ++i) cycle(kTickNs);  // until the drives drive
  }

  void run_block(const RawClock& clock) {
    for (int i = 0; i < kWarmUp; ++i) cycle(step_ns_);
    std::vector<std::int64_t> block_ns(kExchanges);
    for (std::int64_t& each_ns : block_ns) {
      push();
      const std::int64_t began_ns = clock.now_ns();
      cycle(step_ns_);
      each_ns = clock.now_ns() - began_ns;
      resting_ += step_ns_ > 0 && state_.velocity_rad_s[0] == 0;
    }
    median_ns_.push_back(quantile_ns(block_ns, 0.5));
    all_ns_.insert(all_ns_.end(), block_ns.begin(), block_ns.end());
  }

  const std::string& key() const { return key_; }
  std::size_t joints() const { return joints_; }
  const std::vector<std::int64_t>& all_ns() const { return all_ns_; }
  const std::vector<std::int64_t>& median_ns() const { return median_ns_; }
  // Of the exchanges in which time passes. A joint that its friction holds costs no physics worth the name.
  double resting_share() const { return resting_ / std::max(1.0, static_cast<double>(all_ns_.size())); }
  bool missed() const { return actuators_->counters().missed + actuators_->counters().late > 0; }

 private:
  // To and fro, so that no joint comes to rest.
  void push() { command_.torque_nm.fill(command_.tick / kPushTicks % 2 == 0 ? 0.1 : -0.1); }

  void cycle(std::int64_t step_ns) {
    ++command_.tick;
    actuators_->cycle(command_, state_, now_ns_);
    now_ns_ += step_ns;
  }

  std::string key_;
  std::size_t joints_;
  std::int64_t step_ns_;
  std::unique_ptr<hal::Actuators> actuators_;
  hal::ActuatorCommand command_;
  hal::ActuatorState state_;
  std::int64_t now_ns_ = 5'000'000'000;
  std::vector<std::int64_t> all_ns_, median_ns_;
  double resting_ = 0;
};

void exchanges(int rounds, JsonLine& line) {
  std::vector<Subject> subjects;
  subjects.emplace_back(0, false);
  for (const std::size_t joints : {1U, 4U, 12U, 32U})
    for (const bool time_passes : {false, true}) subjects.emplace_back(joints, time_passes);
  const RawClock clock = RawClock::calibrate();
  const ThreadToll before = thread_toll();
  for (int round = 0; round < rounds; ++round)
    for (Subject& subject : subjects) subject.run_block(clock);
  Had had;
  had.add(before, thread_toll());
  bool missed = false;
  double one = 1, most = 0, resting = 0;
  for (const Subject& subject : subjects) {
    line.quantiles(subject.key(), subject.all_ns());
    if (subject.joints() > 0)
      line.number(subject.key() + "_over_empty", middle_ratio(subject.median_ns(), subjects.front().median_ns()));
    missed = missed || subject.missed();
    resting = std::max(resting, subject.resting_share());
    const double median = static_cast<double>(quantile_ns(subject.median_ns(), 0.5));
    if (subject.key() == "exchange_1j") one = median;
    if (subject.key() == "exchange_32j") most = median;
  }
  line.number("scale_away_share", 1 - had.share())
      .number("scale_resting_share", resting)
      .number("scale_unanswered_share", missed ? 1 : 0)
      .number("scale_control_32j_over_1j", most / one)
      .flag("scale_control_failed_as_it_must", most / one >= kControlAtLeast);
}

// The cycles of each robot's Spine; they take turns.
std::vector<std::vector<Cycle>> tick(int rounds, Cores cores, const std::vector<robot::RobotConfig>& robots) {
  std::vector<std::vector<Cycle>> cycles(robots.size());
  for (int round = 0; round < rounds; ++round) {
    for (std::size_t i = 0; i < robots.size(); ++i) {
      SpineRig rig(robots[i], cores);  // alone: another rig's Transport would share the partner core
      rig.run_block(kBlockNs, cycles[i]);
    }
  }
  return cycles;
}

void spines(int rounds, Cores cores, JsonLine& line) {
  const std::vector<std::vector<Cycle>> cycles =
      tick(rounds, cores, {robot_of(1), robot_of(4), robot_of(12), robot_of(32)});
  std::vector<Cycle> all;
  for (std::size_t i = 0; i < cycles.size(); ++i) {
    const std::string joints = std::array{"1j", "4j", "12j", "32j"}[i];
    line.quantiles("scale_tick_" + joints, figure_ns(cycles[i], &Cycle::cost_ns, true))
        .quantiles("scale_transport_" + joints, figure_ns(cycles[i], &Cycle::bus_ns, true));
    all.insert(all.end(), cycles[i].begin(), cycles[i].end());
  }
  line.number("scale_stolen_share", stolen_share(all)).number("scale_preempted_share", preempted_share(all));
}

void cost(Cores cores, JsonLine& line) {
  std::vector<robot::RobotConfig> robots;
  for (const char* file : {LITHE_ROBOTS "/arm.toml", LITHE_ROBOTS "/arm8.toml", LITHE_ROBOTS "/arm32.toml"})
    robots.push_back(or_exit(robot::load_robot(file)));
  const std::vector<std::vector<Cycle>> cycles = tick(kCostRounds, cores, robots);
  std::vector<double> median_ns;
  for (std::size_t i = 0; i < cycles.size(); ++i) {
    const std::string joints = std::array{"1j", "8j", "32j"}[i];
    const auto cost_ns = figure_ns(cycles[i], &Cycle::cost_ns, true);
    median_ns.push_back(static_cast<double>(quantile_ns(cost_ns, 0.5)));
    line.quantiles("tick_cost_" + joints, cost_ns)
        .number("tick_cost_p50_us_" + joints, median_ns.back() / 1e3)
        .number("tick_cost_stolen_share_" + joints, stolen_share(cycles[i]))
        .number("tick_cost_preempted_share_" + joints, preempted_share(cycles[i]));
  }
  const double control = median_ns.back() / median_ns.front();
  line.number("cost_control_32j_over_1j", control)
      .flag("cost_control_failed_as_it_must", control >= kCostControlAtLeast);
}

}  // namespace
}  // namespace lithe::bench

int main(int argc, char** argv) {
  using namespace lithe::bench;
  const int exchange_rounds = argc > 1 ? std::atoi(argv[1]) : 40;
  const int spine_rounds = argc > 2 ? std::atoi(argv[2]) : 6;
  const Cores cores = become_a_spine();
  JsonLine line;
  if (argc > 1 && argv[1] == std::string("cost")) {
    cost(cores, line);
  } else {
    exchanges(exchange_rounds, line);
    spines(spine_rounds, cores, line);
  }
  line.print();
  return 0;
}
