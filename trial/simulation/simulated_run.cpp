// SPDX-License-Identifier: Apache-2.0
#include "trial/simulation/simulated_run.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numbers>
#include <utility>

#include "spine/hal/sim/simulate.hpp"

namespace lithe::trial {
namespace {

namespace flag = wire::telemetry_flag;

constexpr std::int64_t kStartNs = 1'000'000'000;
constexpr double kReadySeconds = 10;
constexpr std::int64_t kSwitchOnNs = 10'000'000;  // a moteus is on 5 ms after it is told
constexpr int kExchangesToSwitchOn = 10;          // a CiA 402 drive goes one state a word
constexpr double kHeldShare = 1e-3;               // of a joint's torque: by less the guard changes nothing worth a word

// From where the joint stands to a distance and back, smoothly, well within its limits: a small one, or, with `shares`,
// that share [-1, 1) of the way that there is.
wire::Plan gentle_plan(const robot::RobotConfig& robot, const JointArray& from_rad, std::int64_t now_ns, double seconds,
                       const JointArray* shares) {
  wire::Plan plan;
  plan.plan_id = 1;
  plan.waypoint_count = wire::kNw;
  plan.joint_count = static_cast<std::uint32_t>(robot.joints.size());
  for (std::size_t w = 0; w < wire::kNw; ++w) {
    const double part = static_cast<double>(w + 1) / wire::kNw;
    plan.t_ns[w] = now_ns + static_cast<std::int64_t>(part * seconds * 1e9);
    for (std::size_t j = 0; j < robot.joints.size(); ++j) {
      const robot::JointConfig& joint = robot.joints[j];
      const double at = std::clamp(from_rad[j], joint.position_min_rad, joint.position_max_rad);
      const double up = joint.position_max_rad - at, down = at - joint.position_min_rad;
      const double most = 0.1 * joint.velocity_max_rad_s * seconds;
      double by = std::copysign(std::min({0.3, 0.4 * std::max(up, down), most}), up - down);
      if (shares != nullptr) by = (*shares)[j] * std::min(0.4 * ((*shares)[j] > 0 ? up : down), most);
      plan.position_rad[w * wire::kNj + j] = at + by * 0.5 * (1 - std::cos(2 * std::numbers::pi * part));
      plan.velocity_rad_s[w * wire::kNj + j] = std::numeric_limits<double>::quiet_NaN();
    }
  }
  return plan;
}

// Lets the source act where the Spine runs a law. Durations are not measured.
class SourceHost final : public step::Host {
 public:
  explicit SourceHost(TorqueSource& source) : source_(source) {}
  std::int64_t now_ns() LITHE_RT override { return 0; }
  contain::Failure run(law::Sandbox& sandbox, std::int64_t) LITHE_RT override {
    source_.step(sandbox.tick, sandbox.effort);
    return {};
  }

 private:
  TorqueSource& source_;
};

// What the step knows of a source: a law without State and Params.
struct NoLaw {
  struct Params {};
  struct State {};
  static void step(const Tick&, const Params&, State&, Effort&) {}
};
constexpr LitheLaw kNoLaw = describe<NoLaw>("on_board");

// Runs until every drive is ready and on. Returns the simulated time then.
Result<std::int64_t> make_ready(const robot::RobotConfig& robot, hal::Actuators& actuators) {
  constexpr std::uint32_t kReady = wire::joint_status::kFresh, kAll = kReady | wire::joint_status::kNotReady;
  const auto period_ns = static_cast<std::int64_t>(1e9 / robot.rate_hz);
  hal::ActuatorCommand command;
  hal::ActuatorState state;
  std::int64_t now_ns = kStartNs;
  command.joints = static_cast<std::uint32_t>(robot.joints.size());
  command.position_rad.fill(kNoTarget);
  const auto cycle = [&] {
    ++command.tick;
    actuators.cycle(command, state, now_ns);
    now_ns += period_ns;
  };
  // A drive answers long before it is set up.
  const auto joint_behind = [&] {
    std::size_t joint = 0;
    while (joint < command.joints && (state.status[joint] & kAll) == kReady) ++joint;
    return joint;
  };
  for (; joint_behind() < command.joints; cycle()) {
    if (now_ns - kStartNs <= static_cast<std::int64_t>(kReadySeconds * 1e9)) continue;
    return Error{"the simulated robot is not ready, joint " + robot.joints[joint_behind()].name + ": " +
                 actuators.why_not_ready()};
  }
  const std::uint32_t divider = step::slowest_drive(robot);
  command.act(hal::DriveAction::torque);
  const std::int64_t on_ns = now_ns + std::max(kSwitchOnNs, kExchangesToSwitchOn * divider * period_ns);
  while (now_ns < on_ns) cycle();
  return now_ns;
}

}  // namespace

robot::RobotConfig with_payload(const robot::RobotConfig& robot) {
  robot::RobotConfig heavy = robot;
  for (robot::JointConfig& joint : heavy.joints) {
    for (double robot::PlantConfig::* mass : {&robot::PlantConfig::inertia_kg_m2, &robot::PlantConfig::mgl_nm,
                                              &robot::PlantConfig::mass_kg, &robot::PlantConfig::link_inertia_kg_m2}) {
      joint.sim.*mass *= 1 + Rough::kPayload;
    }
  }
  return heavy;
}

Result<> open_ready(const robot::RobotConfig& robot, SimulatedRobot& simulated) {
  auto actuators = hal::sim::simulate_actuators(robot);
  if (!actuators) return actuators.error();
  const auto from_ns = make_ready(robot, **actuators);
  if (!from_ns) return from_ns.error();
  simulated.from_ns = *from_ns;
  simulated.actuators = std::move(*actuators);
  return done();
}

void start_inside(robot::RobotConfig& robot) {
  for (robot::JointConfig& joint : robot.joints) {
    const double width_rad = joint.position_max_rad - joint.position_min_rad;
    const double margin_rad = std::min(robot.guard.soft_stop_rad, 0.25 * width_rad);
    joint.sim.initial_position_rad = std::clamp(joint.sim.initial_position_rad, joint.position_min_rad + margin_rad,
                                                joint.position_max_rad - margin_rad);
  }
}

std::array<char, 160> fault_words(const robot::RobotConfig& robot, const LoopStats& stats) {
  std::array<char, 160> text{};
  const auto fault = static_cast<wire::Fault>(stats.fault);
  const robot::JointConfig& joint = robot.joints[stats.fault_joint];
  const char *what = wire::to_string(fault).data(), *name = joint.name.c_str();
  if (fault == wire::Fault::velocity_limit) {
    std::snprintf(text.data(), text.size(), "%s: joint %s at %.3g rad/s, at most %.3g", what, name,
                  stats.fault_velocity_rad_s, joint.velocity_max_rad_s * robot.guard.velocity_overrun);
  } else if (fault == wire::Fault::position_limit) {
    std::snprintf(text.data(), text.size(), "%s: joint %s at %.3g rad, limits %.3g and %.3g", what, name,
                  stats.fault_position_rad, joint.position_min_rad, joint.position_max_rad);
  } else {
    std::snprintf(text.data(), text.size(), "%s", what);
  }
  return text;
}

SimulatedRun::SimulatedRun(const robot::RobotConfig& robot, const SimulatedRobot& simulated, bool rough,
                           const Variation& variation)
    : robot_(robot),
      actuators_(*simulated.actuators),
      now_ns_(simulated.from_ns),
      period_ns_(static_cast<std::int64_t>(1e9 / robot.rate_hz)),
      run_ticks_(simulated.run_ticks),
      rough_(rough),
      random_(variation.seed == 0 ? Rough::kSeed : variation.seed),
      step_(robot, slot_, sandbox_) {
  stats.whole_ticks = ticks_in(kRunSeconds);
  watch();
  command_.joints = late_.joints = static_cast<std::uint32_t>(robot.joints.size());
  command_.act(hal::DriveAction::torque);  // none yet: the drives are on already
  command_.position_rad.fill(kNoTarget);
  late_ = command_;
  exchange();
  law::reset_resident(resident_, kNoLaw);
  resident_.law_id = 1;
  slot_.offer(&resident_);
  // Until the step may be armed: the drives need not know of it.
  NoTorque no_torque;
  SourceHost host(no_torque);
  for (std::uint32_t i = 0; i < step::slowest_drive(robot); ++i)
    step_.run({.tick = 0, .now_ns = now_ns_, .sample = state_, .brain_age_ns = 0}, host, next_, record_);
  JointArray shares{};
  if (variation.seed != 0) std::ranges::generate(shares, [this] { return 2 * uniform() - 1; });
  plan_ = gentle_plan(robot, state_.position_rad, now_ns_, variation.seconds, variation.seed == 0 ? nullptr : &shares);
}

void SimulatedRun::watch() {
  tremor_ = {};
  for (std::uint32_t j = 0; j < robot_.joints.size(); ++j)
    tremor_.configure(robot_.rate_hz, j, {robot_.joints[j].torque_max_nm, robot_.joints[j].velocity_max_rad_s});
}

void SimulatedRun::stop() {
  stopping_ = true;
  watch();
}

std::uint32_t SimulatedRun::ticks_in(double seconds) const {
  return static_cast<std::uint32_t>(std::lround(seconds * robot_.rate_hz));
}

double SimulatedRun::uniform() {
  random_ = random_ * 6364136223846793005u + 1442695040888963407u;  // Knuth's MMIX generator
  return static_cast<double>(random_ >> 11) * 0x1p-53;
}

// About normal: the sum of twelve uniform numbers, less their mean, has the variance 1.
double SimulatedRun::noise() {
  double sum = -6;
  for (int i = 0; i < 12; ++i) sum += uniform();
  return sum;
}

void SimulatedRun::measure() {
  seen_ = state_;
  if (!rough_) return;
  for (std::uint32_t j = 0; j < command_.joints; ++j) {
    seen_.position_rad[j] += Rough::kPositionRad * noise();
    seen_.velocity_rad_s[j] += Rough::kVelocityRadS * noise();
    seen_.torque_nm[j] += Rough::kTorqueShare * robot_.joints[j].torque_max_nm * noise();
  }
}

bool SimulatedRun::tick(TorqueSource& source) {
  exchange();
  measure();
  wire::Command arm;
  arm.kind = static_cast<std::uint32_t>(wire::CommandKind::arm);
  const bool first = stats.ticks == 0;
  SourceHost host(source);
  const step::Report& report = step_.run({.tick = stats.ticks,
                                          .now_ns = now_ns_,
                                          .sample = seen_,
                                          .brain_age_ns = stopping_ ? -1 : 0,
                                          .command = first ? &arm : nullptr,
                                          .plan = first ? &plan_ : nullptr},
                                         host, next_, record_);
  count(report);
  compose(next_);
  if (!stopping_ && fault()) return false;
  const law::Tremor::Finding found = tremor_.find(command_.joints);
  if (found.kind == law::Tremor::Finding::Kind::none) return true;
  stats.tremor = static_cast<std::uint32_t>(found.kind);
  stats.tremor_joint = found.joint;
  stats.tremor_hz = found.frequency_hz;
  stats.tremor_size = found.size;
  return false;
}

// The first of this run, with the first joint that has it. A robot that cannot be armed has drives that do not answer.
bool SimulatedRun::fault() {
  auto found = static_cast<wire::Fault>(record_.fault);
  if (found == wire::Fault::none && step_.mode() == wire::Mode::disarmed) found = wire::Fault::drive_lost;
  if (found == wire::Fault::none) return false;
  stats.fault = static_cast<std::uint32_t>(found);
  stats.fault_tick = stats.ticks;
  for (std::uint32_t j = 0; j < command_.joints; ++j) {
    if (record_.joint_fault[j] != stats.fault) continue;
    stats.fault_joint = j;
    stats.fault_position_rad = state_.position_rad[j];
    stats.fault_velocity_rad_s = state_.velocity_rad_s[j];
    break;
  }
  return true;
}

void SimulatedRun::exchange() {
  actuators_.cycle(command_, state_, now_ns_);
  now_ns_ += period_ns_;
}

void SimulatedRun::count(const step::Report& report) {
  ++stats.ticks;
  stats.torque_clamped += (report.flags & flag::kTorqueClamped) != 0;
  stats.slew_clamped += (report.flags & flag::kSlewClamped) != 0;
  stats.position_clamped += (report.flags & flag::kPositionClamped) != 0;
  stats.velocity_clamped += (report.flags & flag::kVelocityClamped) != 0;
  const Effort& effort = step_.laws().effort();
  const Tick& tick = step_.seen();
  double mean_rad2 = 0;
  for (std::uint32_t j = 0; j < tick.joints; ++j) {
    const double error_rad = tick.setpoint_position_rad[j] - state_.position_rad[j];
    stats.most_torque_nm = std::max(stats.most_torque_nm, std::abs(effort.torque_nm[j]));
    stats.most_velocity_rad_s = std::max(stats.most_velocity_rad_s, std::abs(state_.velocity_rad_s[j]));
    squares_rad2_[j] += error_rad * error_rad;
    mean_rad2 += squares_rad2_[j] / tick.joints;
    stats.joint_rms_error_rad[j] = std::sqrt(squares_rad2_[j] / stats.ticks);
    const double given_nm = record_.command_torque_nm[j];
    const double wanted_nm =
        stopping_ ? given_nm : pd_of(effort, j).felt_nm(tick.position_rad[j], tick.velocity_rad_s[j]);
    const double held_nm = std::abs(wanted_nm - given_nm);
    if (held_nm > kHeldShare * robot_.joints[j].torque_max_nm) {
      if (++held_ticks_[j] > held_ticks_[stats.held_joint]) stats.held_joint = j;
      if (held_nm > std::abs(held_[j].wanted_nm - held_[j].given_nm))
        held_[j] = {stats.ticks, wanted_nm, given_nm, tick.position_rad[j], tick.velocity_rad_s[j]};
    }
    unjudged[j] ? tremor_.skip(j) : tremor_.see(tick, j, wanted_nm);
    if (!stopping_) {
      sums[j].see({tick.setpoint_position_rad[j], tick.position_rad[j], tick.velocity_rad_s[j],
                   tick.setpoint_velocity_rad_s[j], wanted_nm},
                  robot_.joints[j].torque_max_nm);
    }
    stats.most_chatter_hz = std::max(stats.most_chatter_hz, tremor_.chatter_hz(j));
    stats.most_swings = std::max(stats.most_swings, tremor_.swings(j));
  }
  stats.held = held_[stats.held_joint];
  stats.rms_error_rad = std::sqrt(mean_rad2 / stats.ticks);
}

void SimulatedRun::compose(const hal::ActuatorCommand& next) {
  const std::uint64_t tick = command_.tick + 1;
  command_ = rough_ ? late_ : next;
  command_.tick = tick;
  command_.clear_faults = false;
  late_ = next;
  if (rough_) disturb();
}

// Neighbours are pushed in opposite directions.
void SimulatedRun::disturb() {
  const double t_s = static_cast<double>(stats.ticks) / robot_.rate_hz;
  if (t_s < Rough::kKickFromS || t_s >= Rough::kKickFromS + Rough::kKickS) return;
  for (std::uint32_t j = 0; j < command_.joints; ++j) {
    const double kick_nm = Rough::kKickShare * robot_.joints[j].torque_max_nm;
    command_.torque_nm[j] += j % 2 == 0 ? kick_nm : -kick_nm;
    command_.max_torque_nm[j] += kick_nm;
  }
}

}  // namespace lithe::trial
