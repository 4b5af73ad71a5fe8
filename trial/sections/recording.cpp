// SPDX-License-Identifier: Apache-2.0
#include "trial/sections/recording.hpp"

#include <algorithm>
#include <bit>
#include <cstring>
#include <iterator>
#include <limits>
#include <memory>

#include "spine/ipc/layout.hpp"
#include "spine/ipc/segment.hpp"
#include "spine/law/dry_inputs.hpp"
#include "spine/law/migrate.hpp"
#include "spine/load/loader.hpp"

namespace lithe::trial {
namespace {

// What is kept of a record, in the order of Recording::Quantity.
constexpr std::array<std::array<double, wire::kNj> wire::Telemetry::*, 6> kKept{
    &wire::Telemetry::position_rad,
    &wire::Telemetry::velocity_rad_s,
    &wire::Telemetry::torque_nm,
    &wire::Telemetry::setpoint_position_rad,
    &wire::Telemetry::setpoint_velocity_rad_s,
    &wire::Telemetry::command_torque_nm};

}  // namespace

Recording::Recording(const std::string& robot, std::uint64_t values_hash, std::uint32_t joints, double dt_s,
                     double seconds)
    : joints_(joints), dt_s_(dt_s) {
  if (robot.empty() || !ipc::Lease::is_held(ipc::Segment<ipc::SpineMemory>::path(robot))) return;
  const auto segment = ipc::Segment<ipc::SpineMemory>::attach(robot, ipc::Access::read);
  if (!segment) return;
  wire::RobotInfo info{};
  of_another_ =
      ipc::ChannelReader<wire::RobotInfo>((*segment)->robot_info).read(info) && info.values_hash != values_hash;
  read_state(**segment);
  const auto record = std::make_unique<wire::Telemetry>();
  ipc::RingReader<wire::Telemetry, wire::spine_segment::kTelemetryDepth> reader((*segment)->telemetry);
  if (!reader.latest(*record) || record->joint_count != joints) return;
  reader.rewind();
  // The ring has a fixed length; the writer may overwrite the oldest records during the read.
  const auto most = std::min<std::size_t>(static_cast<std::size_t>(seconds / dt_s), 4000);
  const std::uint64_t newest = record->tick;
  records_.reserve(most);
  values_.reserve(most * kQuantities * joints);
  while (!reader.empty() && records_.size() < most) {
    if (!reader.next(*record) || record->tick + most <= newest || !load::is_finite(*record, joints)) continue;
    records_.push_back({record->tick,
                        record->release_ns,
                        record->sample_ns,
                        record->brain_age_ns,
                        record->flags,
                        {},
                        {},
                        record->input_age_ns});
    std::copy(record->sensor.begin(), record->sensor.end(), records_.back().sensor.begin());
    std::copy(record->input.begin(), record->input.end(), records_.back().input.begin());
    for (const auto quantity : kKept)
      values_.insert(values_.end(), ((*record).*quantity).begin(), ((*record).*quantity).begin() + joints);
  }
}

void Recording::read_state(const ipc::SpineMemory& spine) {
  wire::LawState state;
  if (!ipc::ChannelReader<wire::LawState>(spine.law_state).read(state)) return;
  LitheLaw running{};
  running.state_size = std::min<std::uint32_t>(state.state_bytes, kMaxStateBytes);
  for (const auto& channel : spine.law_info) {
    wire::LawInfo info;
    if (!ipc::ChannelReader<wire::LawInfo>(channel).read(info) || info.law_id != state.law_id) continue;
    for (std::uint32_t i = 0; i < std::min<std::size_t>(info.state_field_count, kMaxStateFields); ++i) {
      LitheStateField field{};
      std::copy_n(info.state_name.begin() + i * sizeof field.name, sizeof field.name - 1, std::begin(field.name));
      field.kind = info.state_kind[i];
      field.offset = info.state_offset[i];
      field.count = info.state_elements[i];
      const std::uint64_t end = field.offset + std::uint64_t{kind_bytes(FieldKind{field.kind})} * field.count;
      if (end <= running.state_size) running.state[running.state_count++] = field;
    }
  }
  running_ = running;
  std::memcpy(state_.data(), state.bytes.data(), state_.size());
}

std::uint32_t Recording::carry(const LitheLaw& law, std::span<std::byte> state) const {
  if (law.state_size > state.size()) return 0;
  const law::Migration plan = law::plan_migration(running_, law);
  return plan.count - static_cast<std::uint32_t>(std::popcount(apply_migration(plan, state_.data(), state.data())));
}

void Recording::fill(Tick& tick, std::size_t i) const {
  const Record& record = records_[i];
  tick.tick = record.tick;
  tick.t_ns = record.t_ns;
  tick.t_s = static_cast<double>(i) * dt_s_;
  tick.dt_s = dt_s_;
  tick.joints = joints_;
  namespace flag = wire::telemetry_flag;
  tick.flags = ((record.flags & flag::kSampleStale) != 0 ? kSampleStale : 0) |
               ((record.flags & flag::kBrainStale) != 0 ? kBrainStale : 0);
  tick.sample_age_s = static_cast<double>(record.t_ns - record.sample_ns) * 1e-9;
  tick.brain_age_s = record.brain_age_ns < 0 ? std::numeric_limits<double>::infinity()
                                             : static_cast<double>(record.brain_age_ns) * 1e-9;
  tick.sensor = record.sensor;
  tick.input = record.input;
  tick.input_age_s = record.input_age_ns < 0 ? std::numeric_limits<double>::infinity()
                                             : static_cast<double>(record.input_age_ns) * 1e-9;
  const std::size_t before = i == 0 ? 0 : i - 1;
  for (std::uint32_t j = 0; j < joints_; ++j) {
    tick.position_rad[j] = at(i, position, j);
    tick.velocity_rad_s[j] = at(i, velocity, j);
    tick.torque_nm[j] = at(i, torque, j);
    tick.setpoint_position_rad[j] = at(i, setpoint_position, j);
    tick.setpoint_velocity_rad_s[j] = at(i, setpoint_velocity, j);
    tick.setpoint_acceleration_rad_s2[j] = (at(i, setpoint_velocity, j) - at(before, setpoint_velocity, j)) / dt_s_;
  }
}

std::vector<PastTick> Recording::past(std::size_t most, std::uint32_t joints, double dt_s) const {
  std::vector<PastTick> ticks(records_.empty() ? most : std::min(most, records_.size()));
  Tick dry;
  for (std::size_t back = 0; back < ticks.size(); ++back) {
    PastTick& past = ticks[back];
    past.age_s = static_cast<double>(back) * dt_s;
    if (records_.empty())
      law::dry_input(dry, ticks.size() - back + law::kDryStepsAtRest, joints);
    else
      fill(dry, records_.size() - 1 - back);
    past.position_rad = dry.position_rad;
    past.velocity_rad_s = dry.velocity_rad_s;
    past.torque_nm = dry.torque_nm;
    past.setpoint_position_rad = dry.setpoint_position_rad;
    past.setpoint_velocity_rad_s = dry.setpoint_velocity_rad_s;
    past.sensor = dry.sensor;
    for (std::uint32_t j = 0; j < joints && !records_.empty(); ++j)
      past.command_torque_nm[j] = command_torque_nm(records_.size() - 1 - back, j);
  }
  return ticks;
}

}  // namespace lithe::trial
