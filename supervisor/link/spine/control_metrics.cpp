// SPDX-License-Identifier: Apache-2.0
#include "supervisor/link/spine/control_metrics.hpp"

#include <algorithm>
#include <cmath>
#include <memory>

namespace lithe::control {
namespace {

namespace flag = wire::telemetry_flag;
constexpr std::uint32_t kClamped =
    flag::kTorqueClamped | flag::kSlewClamped | flag::kPositionClamped | flag::kVelocityClamped | flag::kPowerClamped;
constexpr double kAll = 0.999;        // of torque_max_nm
constexpr double kClampedBy = 0.001;  // likewise: by less the guard changes nothing worth a word

// Calls `see` for each record of ticks (from, to] that is still in the ring, oldest first.
template <class See>
void each_record(const SpineLink& spine, std::uint64_t from, std::uint64_t to, See see) {
  auto now = std::make_unique<wire::Telemetry>();
  if (!spine.latest(*now) || to <= from) return;
  ipc::RingReader<wire::Telemetry, wire::spine_segment::kTelemetryDepth> ring(spine.memory().telemetry);
  ring.rewind(now->tick - std::min(now->tick, from) + 1);
  // Test empty(): next() is false also for a record that was overwritten while it was read.
  while (!ring.empty()) {
    if (!ring.next(*now) || now->tick <= from) continue;
    if (now->tick > to) break;
    see(*now);
  }
}

double aligned_error_rad(const wire::Telemetry& record, std::size_t joint) {
  const std::int64_t woke_ns = record.release_ns + record.release_jitter_ns;
  const double older_s = record.sample_ns == 0 ? 0 : static_cast<double>(woke_ns - record.sample_ns) * 1e-9;
  return record.setpoint_position_rad[joint] - record.setpoint_velocity_rad_s[joint] * older_s -
         record.position_rad[joint];
}

void see(const wire::Telemetry& record, const wire::RobotInfo& info, std::size_t j, JointControl& joint) {
  const double error_rad = aligned_error_rad(record, j), torque_nm = record.command_torque_nm[j];
  joint.rms_error_rad += error_rad * error_rad;  // the sums, until the end
  joint.rms_torque_nm += torque_nm * torque_nm;
  joint.max_error_rad = std::max(joint.max_error_rad, std::abs(error_rad));
  joint.max_torque_nm = std::max(joint.max_torque_nm, std::abs(torque_nm));
  joint.at_limit += std::abs(torque_nm) >= kAll * info.torque_max_nm[j] ? 1 : 0;
  const bool changed = std::abs(record.law_torque_nm[j] - torque_nm) > kClampedBy * info.torque_max_nm[j];
  joint.clamped += (record.flags & kClamped) != 0 && changed ? 1 : 0;
  const double jump_nm = law::Tremor::kJumpShare * info.torque_max_nm[j];
  joint.chatter_hz += joint.wanted.see(record.law_torque_nm[j], jump_nm).ticks > 0 ? 0.5 : 0;  // two turns are a period
  joint.sums.see({record.setpoint_position_rad[j], record.position_rad[j], record.velocity_rad_s[j],
                  record.setpoint_velocity_rad_s[j], torque_nm},
                 kAll * info.torque_max_nm[j]);
}

}  // namespace

std::uint32_t law_in(const SpineLink& spine, std::uint64_t tick) {
  std::uint32_t law_id = 0;
  each_record(spine, tick - 1, tick, [&](const wire::Telemetry& record) { law_id = record.law_id; });
  return law_id;
}

LawControl measure_control(const SpineLink& spine, std::uint32_t law_id, std::uint64_t from_tick,
                           std::uint64_t to_tick) {
  const wire::RobotInfo& info = spine.info();
  LawControl found;
  found.joints.resize(std::min<std::size_t>(info.joint_count, wire::kNj));
  auto last = std::make_unique<wire::Telemetry>();
  each_record(spine, from_tick, to_tick, [&](const wire::Telemetry& record) {
    if (record.law_id != law_id || record.mode != static_cast<std::uint32_t>(wire::Mode::active)) return;
    ++found.ticks;
    found.clamped += (record.flags & kClamped) != 0 ? 1 : 0;
    const bool follows = last->tick != 0;
    if (follows) found.missed += record.missed_releases - std::min(record.missed_releases, last->missed_releases);
    for (std::size_t j = 0; j < found.joints.size(); ++j) {
      see(record, info, j, found.joints[j]);
      if (follows) found.joints[j].moved_rad += std::abs(record.position_rad[j] - last->position_rad[j]);
    }
    *last = record;
  });
  const double ticks = std::max(1u, found.ticks);
  found.clamped /= ticks;
  for (JointControl& joint : found.joints) {
    joint.rms_error_rad = std::sqrt(joint.rms_error_rad / ticks);
    joint.rms_torque_nm = std::sqrt(joint.rms_torque_nm / ticks);
    joint.at_limit /= ticks;
    joint.clamped /= ticks;
    joint.chatter_hz *= info.rate_hz / ticks;
  }
  return found;
}

}  // namespace lithe::control
