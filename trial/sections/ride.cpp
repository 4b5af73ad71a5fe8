// SPDX-License-Identifier: Apache-2.0
#include "trial/sections/ride.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace lithe::trial {
namespace {

namespace flag = wire::telemetry_flag;

constexpr double kHeldShare = 1e-3;  // of a joint's torque: by less the guard changes nothing worth a word

// From where the joint stands to a small distance and back, smoothly, well within its limits.
wire::Plan gentle_plan(const robot::RobotConfig& robot, const JointArray& from_rad, std::int64_t now_ns) {
  wire::Plan plan;
  plan.plan_id = 1;
  plan.waypoint_count = wire::kNw;
  plan.joint_count = static_cast<std::uint32_t>(robot.joints.size());
  for (std::size_t w = 0; w < wire::kNw; ++w) {
    const double part = static_cast<double>(w + 1) / wire::kNw;
    plan.t_ns[w] = now_ns + static_cast<std::int64_t>(part * kRideSeconds * 1e9);
    for (std::size_t j = 0; j < robot.joints.size(); ++j) {
      const robot::JointConfig& joint = robot.joints[j];
      const double at = std::clamp(from_rad[j], joint.position_min_rad, joint.position_max_rad);
      const double up = joint.position_max_rad - at, down = at - joint.position_min_rad;
      const double room = std::min(0.4 * std::max(up, down), 0.1 * joint.velocity_max_rad_s * kRideSeconds);
      const double by = std::copysign(std::min(0.3, room), up - down);
      plan.position_rad[w * wire::kNj + j] = at + by * 0.5 * (1 - std::cos(2 * std::numbers::pi * part));
      plan.velocity_rad_s[w * wire::kNj + j] = std::numeric_limits<double>::quiet_NaN();
    }
  }
  return plan;
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

Ride::Ride(const robot::RobotConfig& robot, const SimulatedRobot& simulated, bool rough)
    : robot_(robot),
      actuators_(*simulated.actuators),
      now_ns_(simulated.from_ns),
      period_ns_(static_cast<std::int64_t>(1e9 / robot.rate_hz)),
      ride_ticks_(simulated.ride_ticks),
      rough_(rough) {
  stats.whole_ticks = ticks_in(kRideSeconds);
  plan_.configure(robot);
  guard_.configure(robot);
  watch();
  command_.joints = tick_.joints = static_cast<std::uint32_t>(robot.joints.size());
  tick_.dt_s = 1 / robot.rate_hz;
  command_.act(hal::DriveAction::torque);  // none yet: the drives are on already
  command_.position_rad.fill(kNoTarget);
  late_.position_rad.fill(kNoTarget);
  exchange();
  plan_.hold_at(state_.position_rad);
  guard_.reset_output();
  plan_.accept(gentle_plan(robot, state_.position_rad, now_ns_), now_ns_);
}

void Ride::watch() {
  tremor_ = {};
  for (std::uint32_t j = 0; j < robot_.joints.size(); ++j) {
    tremor_.configure(robot_.rate_hz, j, {robot_.joints[j].torque_max_nm, robot_.joints[j].velocity_max_rad_s});
  }
}

void Ride::stop() {
  mode_ = wire::Mode::safe_stop;
  plan_.hold_at(state_.position_rad);
  watch();
}

std::uint32_t Ride::ticks_in(double seconds) const {
  return static_cast<std::uint32_t>(std::lround(seconds * robot_.rate_hz));
}

// About normal: the sum of twelve uniform numbers, less their mean, has the variance 1.
double Ride::noise() {
  double sum = -6;
  for (int i = 0; i < 12; ++i) {
    random_ = random_ * 6364136223846793005u + 1442695040888963407u;  // Knuth's MMIX generator
    sum += static_cast<double>(random_ >> 11) * 0x1p-53;
  }
  return sum;
}

const Tick& Ride::look() {
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
    if (!rough_) continue;
    tick_.position_rad[j] += Rough::kPositionRad * noise();
    tick_.velocity_rad_s[j] += Rough::kVelocityRadS * noise();
    tick_.torque_nm[j] += Rough::kTorqueShare * robot_.joints[j].torque_max_nm * noise();
  }
  tick_.sample_age_s = 1e-9 * static_cast<double>(now_ns_ - state_.sample_ns);
  tick_.sensor = state_.sensor;
  return tick_;
}

bool Ride::act(const Effort& effort) {
  const bool stopping = mode_ == wire::Mode::safe_stop;
  const guard::Verdict verdict = guard_.check(
      {mode_, 0, 0,
       stopping ? tick_.position_rad : state_.position_rad,  // the safe law sees no better than a law
       stopping ? tick_.velocity_rad_s : state_.velocity_rad_s, state_.status, effort, tick_.t_ns - state_.sample_ns},
      output_);
  count(verdict.flags, effort);
  compose();
  if (verdict.fault != wire::Fault::none && !stopping) {
    stats.fault = static_cast<std::uint32_t>(verdict.fault);
    stats.fault_tick = stats.ticks;
    name_fault();
    return false;
  }
  const law::Tremor::Finding found = tremor_.find(tick_.joints);
  if (found.kind == law::Tremor::Finding::Kind::none) return true;
  stats.tremor = static_cast<std::uint32_t>(found.kind);
  stats.tremor_joint = found.joint;
  stats.tremor_hz = found.frequency_hz;
  stats.tremor_size = found.size;
  return false;
}

void Ride::name_fault() {
  for (const guard::Group& group : guard_.groups()) {
    if (!group.news) continue;
    stats.fault_joint = group.joint;
    stats.fault_position_rad = state_.position_rad[group.joint];
    stats.fault_velocity_rad_s = state_.velocity_rad_s[group.joint];
    return;
  }
}

void Ride::exchange() {
  actuators_.cycle(command_, state_, now_ns_);
  guard_.dispatched();  // or it bounds every torque from the first one, which is none
  now_ns_ += period_ns_;
  ++command_.tick;
}

void Ride::count(std::uint32_t flags, const Effort& effort) {
  ++stats.ticks;
  stats.torque_clamped += (flags & flag::kTorqueClamped) != 0;
  stats.slew_clamped += (flags & flag::kSlewClamped) != 0;
  stats.position_clamped += (flags & flag::kPositionClamped) != 0;
  stats.velocity_clamped += (flags & flag::kVelocityClamped) != 0;
  double mean_rad2 = 0;
  for (std::uint32_t j = 0; j < tick_.joints; ++j) {
    const double error_rad = tick_.setpoint_position_rad[j] - state_.position_rad[j];
    stats.most_torque_nm = std::max(stats.most_torque_nm, std::abs(effort.torque_nm[j]));
    stats.most_velocity_rad_s = std::max(stats.most_velocity_rad_s, std::abs(state_.velocity_rad_s[j]));
    squares_rad2_[j] += error_rad * error_rad;
    mean_rad2 += squares_rad2_[j] / tick_.joints;
    stats.joint_rms_error_rad[j] = std::sqrt(squares_rad2_[j] / stats.ticks);
    const double given_nm = guard_.expected_torque_nm()[j];
    const double wanted_nm = mode_ == wire::Mode::safe_stop
                                 ? given_nm
                                 : pd_of(effort, j).felt_nm(tick_.position_rad[j], tick_.velocity_rad_s[j]);
    if (std::abs(wanted_nm - given_nm) > kHeldShare * robot_.joints[j].torque_max_nm) {
      if (++held_ticks_[j] > held_ticks_[stats.held_joint]) stats.held_joint = j;
    }
    tremor_.see(tick_, j, wanted_nm);
    stats.most_chatter_hz = std::max(stats.most_chatter_hz, tremor_.chatter_hz(j));
    stats.most_swings = std::max(stats.most_swings, tremor_.swings(j));
  }
  stats.rms_error_rad = std::sqrt(mean_rad2 / stats.ticks);
}

void Ride::compose() {
  const guard::Output& leaves = rough_ ? late_ : output_;
  command_.act(hal::DriveAction::torque);
  command_.torque_nm = leaves.torque_nm;
  command_.position_rad = leaves.position_rad;
  command_.velocity_rad_s = leaves.velocity_rad_s;
  command_.kp_nm_rad = leaves.kp_nm_rad;
  command_.kd_nm_s_rad = leaves.kd_nm_s_rad;
  command_.max_torque_nm = leaves.max_torque_nm;
  late_ = output_;
  if (rough_) disturb();
}

// Neighbours are pushed in opposite directions.
void Ride::disturb() {
  const double t_s = static_cast<double>(stats.ticks) / robot_.rate_hz;
  if (t_s < Rough::kKickFromS || t_s >= Rough::kKickFromS + Rough::kKickS) return;
  for (std::uint32_t j = 0; j < command_.joints; ++j) {
    const double kick_nm = Rough::kKickShare * robot_.joints[j].torque_max_nm;
    command_.torque_nm[j] += j % 2 == 0 ? kick_nm : -kick_nm;
    command_.max_torque_nm[j] += kick_nm;
  }
}

}  // namespace lithe::trial
