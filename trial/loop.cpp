// SPDX-License-Identifier: Apache-2.0
// The law at the wheel of the simulated robot: the tick's own order, on a clock that is only an argument.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <limits>
#include <memory>
#include <numbers>

#include "spine/guard/guard.hpp"
#include "spine/plan/interpolator.hpp"
#include "trial/sections.hpp"

namespace lithe::trial {
namespace {

namespace flag = wire::telemetry_flag;

constexpr double kSeconds = 1.0;
constexpr double kMandatorySeconds = 0.1;  // of the robot's time, whatever its rate
constexpr std::int64_t kStartNs = 1'000'000'000;
constexpr double kReadySeconds = 10;
constexpr double kMostRideMs = 2000;  // of the processor's time, on top of the box: who asks does not wait for ever
constexpr std::int64_t kSwitchOnNs = 10'000'000;  // a moteus is on 5 ms after it is told
constexpr int kExchangesToSwitchOn = 10;          // a CiA 402 drive goes one state a word

// From where the joint stands to a small distance and back, smoothly, well within its limits.
wire::Plan gentle_plan(const robot::RobotConfig& robot, const JointArray& from_rad, std::int64_t now_ns) {
  wire::Plan plan;
  plan.plan_id = 1;
  plan.waypoint_count = wire::kNw;
  plan.joint_count = static_cast<std::uint32_t>(robot.joints.size());
  for (std::size_t w = 0; w < wire::kNw; ++w) {
    const double part = static_cast<double>(w + 1) / wire::kNw;
    plan.t_ns[w] = now_ns + static_cast<std::int64_t>(part * kSeconds * 1e9);
    for (std::size_t j = 0; j < robot.joints.size(); ++j) {
      const robot::JointConfig& joint = robot.joints[j];
      const double at = std::clamp(from_rad[j], joint.position_min_rad, joint.position_max_rad);
      const double up = joint.position_max_rad - at, down = at - joint.position_min_rad;
      const double room = std::min(0.4 * std::max(up, down), 0.1 * joint.velocity_max_rad_s * kSeconds);
      const double by = std::copysign(std::min(0.3, room), up - down);
      plan.position_rad[w * wire::kNj + j] = at + by * 0.5 * (1 - std::cos(2 * std::numbers::pi * part));
      plan.velocity_rad_s[w * wire::kNj + j] = std::numeric_limits<double>::quiet_NaN();
    }
  }
  return plan;
}

// Contract: allocates nothing once made · about 40 KiB
class Ride {
 public:
  Ride(const Setting& setting, hal::Actuators& actuators)
      : setting_(setting), actuators_(actuators), now_ns_(setting.ride_from_ns) {
    plan_.configure(setting.robot);
    guard_.configure(setting.robot);
    command_.joints = tick_.joints = setting.joints();
    tick_.dt_s = setting.dt_s();
    command_.act(hal::DriveAction::torque);  // none yet: the drives are on already
    command_.position_rad.fill(std::numeric_limits<double>::quiet_NaN());
    exchange();
    plan_.hold_at(state_.position_rad);
    guard_.reset_output();
    plan_.accept(gentle_plan(setting.robot, state_.position_rad, now_ns_), now_ns_);
  }

  std::uint32_t ticks_in(double seconds) const {
    return static_cast<std::uint32_t>(std::lround(seconds * setting_.robot.rate_hz));
  }
  bool over() const { return stats.ticks >= ticks_in(kSeconds); }

  // The next input of the law.
  const Tick& look() {
    exchange();
    plan_.sample(now_ns_, setpoint_);
    tick_.tick = stats.ticks;
    tick_.t_ns = now_ns_;
    tick_.t_s = static_cast<double>(stats.ticks) * tick_.dt_s;
    for (std::uint32_t j = 0; j < tick_.joints; ++j) {
      tick_.position_rad[j] = state_.position_rad[j];
      tick_.velocity_rad_s[j] = state_.velocity_rad_s[j];
      tick_.torque_nm[j] = state_.torque_nm[j];
      tick_.setpoint_position_rad[j] = setpoint_.position_rad[j];
      tick_.setpoint_velocity_rad_s[j] = setpoint_.velocity_rad_s[j];
      tick_.setpoint_acceleration_rad_s2[j] = setpoint_.acceleration_rad_s2[j];
    }
    tick_.sample_age_s = 1e-9 * static_cast<double>(now_ns_ - state_.sample_ns);
    tick_.sensor = state_.sensor;
    return tick_;
  }

  // Its output, through the guard to the drives. False when the guard takes over for good.
  bool act(const Effort& effort) {
    const guard::Verdict verdict = guard_.check(
        {wire::Mode::active,
         0,
         0,
         state_.position_rad,
         state_.velocity_rad_s,
         state_.status,
         {effort.torque_nm, effort.position_rad, effort.velocity_rad_s, effort.kp_nm_rad, effort.kd_nm_s_rad}},
        output_);
    count(verdict.flags, effort);
    compose();
    if (verdict.fault == wire::Fault::none) return true;
    stats.fault = static_cast<std::uint32_t>(verdict.fault);
    stats.fault_tick = stats.ticks;
    return false;
  }

  LoopStats stats;

 private:
  void exchange() {
    actuators_.cycle(command_, state_, now_ns_);
    guard_.dispatched();  // or it bounds every torque from the first one, which is none
    now_ns_ += setting_.period_ns();
    ++command_.tick;
  }

  void count(std::uint32_t flags, const Effort& effort) {
    ++stats.ticks;
    stats.torque_clamped += (flags & flag::kTorqueClamped) != 0;
    stats.slew_clamped += (flags & flag::kSlewClamped) != 0;
    stats.position_clamped += (flags & flag::kPositionClamped) != 0;
    stats.velocity_clamped += (flags & flag::kVelocityClamped) != 0;
    double squares = 0;
    for (std::uint32_t j = 0; j < tick_.joints; ++j) {
      stats.most_torque_nm = std::max(stats.most_torque_nm, std::abs(effort.torque_nm[j]));
      stats.most_velocity_rad_s = std::max(stats.most_velocity_rad_s, std::abs(tick_.velocity_rad_s[j]));
      squares += std::pow(tick_.setpoint_position_rad[j] - tick_.position_rad[j], 2) / tick_.joints;
    }
    sum_of_squares_ += squares;
    stats.rms_error_rad = std::sqrt(sum_of_squares_ / stats.ticks);
  }

  void compose() {
    command_.act(hal::DriveAction::torque);
    command_.torque_nm = output_.torque_nm;
    command_.position_rad = output_.position_rad;
    command_.velocity_rad_s = output_.velocity_rad_s;
    command_.kp_nm_rad = output_.kp_nm_rad;
    command_.kd_nm_s_rad = output_.kd_nm_s_rad;
    command_.max_torque_nm = output_.max_torque_nm;
  }

  const Setting& setting_;
  hal::Actuators& actuators_;
  std::int64_t now_ns_;
  hal::ActuatorCommand command_;
  hal::ActuatorState state_;
  plan::Interpolator plan_;
  plan::Setpoint setpoint_;
  guard::Guard guard_;
  guard::Output output_;
  Tick tick_;
  double sum_of_squares_ = 0;
};

// The guard holds every law, but a law that leans on it all the time is not the law its author meant.
struct Bound {
  std::uint32_t LoopStats::* count;
  double share;
  const char* what;
};
constexpr Bound kBounds[] = {
    {&LoopStats::position_clamped, 0.1, "pushes a joint against its position limit"},
    {&LoopStats::velocity_clamped, 0.1, "drives a joint to its velocity limit"},
    {&LoopStats::slew_clamped, 0.25, "changes its torque faster than torque_slew_nm_s allows"},
    {&LoopStats::torque_clamped, 0.8, "asks for more than torque_max_nm"},
};

bool judge(Bench& bench) {
  const LoopStats &law = bench.report.loop, &alone = bench.setting.baseline;
  // A robot that falls out of its limits by itself is stopped in any case; a law must not hasten that.
  if (law.fault != 0 && (alone.fault == 0 || law.fault_tick < alone.fault_tick)) {
    std::array<char, 64> otherwise{"nothing happened"};
    if (alone.fault != 0) std::snprintf(otherwise.data(), otherwise.size(), "it took %u ticks", alone.fault_tick);
    return bench.refuse(
        "with the simulated robot the guard had to stop it after %u ticks (%s); without a law %s: look at the sign and "
        "the size of its gains",
        law.fault_tick, wire::to_string(static_cast<wire::Fault>(law.fault)).data(), otherwise.data());
  }
  for (const Bound& bound : kBounds) {
    const double share = law.*bound.count / std::max(1.0, static_cast<double>(law.ticks));
    // What happened before that ride was broken off is no excuse for all of a longer one.
    const double anyway =
        alone.*bound.count / std::max({1.0, static_cast<double>(alone.ticks), static_cast<double>(law.ticks)});
    if (share <= bound.share + anyway) continue;
    return bench.refuse(
        "with the simulated robot it %s in %.0f %% of %u ticks (at most %.0f %%): look at the sign and "
        "the size of its gains, and filter what it differentiates",
        bound.what, 100 * share, law.ticks, 100 * (bound.share + anyway));
  }
  return true;
}

// Lives until every drive can be commanded, and is on. Where the robot's own clock is then.
Result<std::int64_t> make_ready(const robot::RobotConfig& robot, hal::Actuators& actuators) {
  constexpr std::uint32_t kReady = wire::joint_status::kFresh, kAll = kReady | wire::joint_status::kNotReady;
  const auto period_ns = static_cast<std::int64_t>(1e9 / robot.rate_hz);
  hal::ActuatorCommand command;
  hal::ActuatorState state;
  std::int64_t now_ns = kStartNs;
  command.joints = static_cast<std::uint32_t>(robot.joints.size());
  command.position_rad.fill(std::numeric_limits<double>::quiet_NaN());
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
                 actuators.trouble()};
  }
  std::uint32_t divider = 1;
  for (const robot::DeviceConfig& device : robot.devices) divider = std::max(divider, device.rate_divider);
  command.act(hal::DriveAction::torque);
  const std::int64_t on_ns = now_ns + std::max(kSwitchOnNs, kExchangesToSwitchOn * divider * period_ns);
  while (now_ns < on_ns) cycle();
  return now_ns;
}

Result<> open_ready(Setting& setting) {
  auto actuators = hal::simulate_actuators(setting.robot);
  if (!actuators) return actuators.error();
  const auto from_ns = make_ready(setting.robot, **actuators);
  if (!from_ns) return from_ns.error();
  setting.ride_from_ns = *from_ns;
  setting.actuators = std::move(*actuators);
  return done();
}

LoopStats ride_without_a_law(const Setting& setting) {
  Ride ride(setting, *setting.actuators);
  Effort nothing;
  nothing.clear(setting.joints());
  do ride.look();
  while (ride.act(nothing) && !ride.over());
  return ride.stats;
}

}  // namespace

bool run_loop(Bench& bench) {
  Ride ride(bench.setting, *bench.setting.actuators);
  bench.one.reset();
  bool going = true;
  while (going && !ride.over()) {
    if (ride.stats.ticks >= ride.ticks_in(kMandatorySeconds) && bench.out_of_time()) break;
    bench.doing("tick %u with the simulated robot", ride.stats.ticks);
    bench.one.step(ride.look());
    if (!bench.sound(bench.one)) return false;
    going = ride.act(bench.one.effort());
    bench.report.loop = ride.stats;
    bench.progress().steps = ride.stats.ticks;
  }
  return judge(bench);
}

Result<> prepare_ride(Setting& setting) {
  if (auto opened = open_ready(setting); !opened) return opened;
  const std::clock_t from = std::clock();  // of this process, whoever else wants the processor
  setting.baseline = ride_without_a_law(setting);
  const double took_ms = 1e3 * static_cast<double>(std::clock() - from) / CLOCKS_PER_SEC;
  // The guard may have broken it off: a law may keep the robot going to the end. A few ticks tell little of a whole
  // ride.
  const double whole_ms = took_ms * kSeconds * setting.robot.rate_hz / setting.baseline.ticks;
  setting.ride_ms = static_cast<int>(std::ceil(std::min(whole_ms, kMostRideMs)));
  return open_ready(setting);
}

}  // namespace lithe::trial
