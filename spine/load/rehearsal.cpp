// SPDX-License-Identifier: Apache-2.0
#include "spine/load/rehearsal.hpp"

#include <algorithm>
#include <cstdio>
#include <string_view>

#include "spine/core/joints.hpp"
#include "spine/core/time.hpp"
#include "spine/law/dry_inputs.hpp"

namespace lithe::load {
namespace {

constexpr std::int64_t kMostNs = 20'000'000;  // limit of one call, on a core that is shared

struct Start {
  decltype(LitheLaw::init) init;
  const History* history;
  law::Sandbox* sandbox;
};

void call_init(void* context) {
  const Start& start = *static_cast<const Start*>(context);
  start.init(start.history, start.sandbox->params.data(), start.sandbox->state.data());
}

void call_step(void* context) { static_cast<law::Sandbox*>(context)->call(); }

void copy(const wire::Telemetry& record, std::int64_t now_ns, std::uint32_t joints, PastTick& tick) {
  tick.age_s = static_cast<double>(now_ns - record.release_ns) * 1e-9;
  copy_joints(record.position_rad, tick.position_rad, joints);
  copy_joints(record.velocity_rad_s, tick.velocity_rad_s, joints);
  copy_joints(record.torque_nm, tick.torque_nm, joints);
  copy_joints(record.setpoint_position_rad, tick.setpoint_position_rad, joints);
  copy_joints(record.setpoint_velocity_rad_s, tick.setpoint_velocity_rad_s, joints);
  copy_joints(record.command_torque_nm, tick.command_torque_nm, joints);
  tick.sensor = record.sensor;
}

}  // namespace

bool is_finite(const wire::Telemetry& record, std::uint32_t joints) {
  return all_finite(record.position_rad, joints) && all_finite(record.velocity_rad_s, joints) &&
         all_finite(record.torque_nm, joints) && all_finite(record.setpoint_position_rad, joints) &&
         all_finite(record.setpoint_velocity_rad_s, joints) && all_finite(record.command_torque_nm, joints);
}

Rehearsal::Rehearsal(const ipc::SpineMemory& spine, std::uint32_t joints, double dt_s, law::Sandbox& sandbox)
    : spine_(spine),
      joints_(joints),
      dt_s_(dt_s),
      sandbox_(sandbox),
      past_(std::make_unique<std::array<PastTick, kMostPast>>()) {}

bool Rehearsal::prepare(law::Resident& law, std::int64_t now_ns, std::span<char> why) {
  return start(law, now_ns, why) && dry_steps(law, why);
}

bool Rehearsal::start(law::Resident& law, std::int64_t now_ns, std::span<char> why) {
  if (law.descriptor->init == nullptr) return true;
  Tick tick;
  tick.joints = joints_;
  sandbox_.enter(law, tick);
  Start start{law.descriptor->init, &look_back(now_ns), &sandbox_};
  if (!contained(&call_init, &start, "init", why)) return false;
  sandbox_.keep_state(law);
  return true;
}

// The newest first. Left out: records that are overwritten during the read, and those with a NaN of a broken sensor.
const History& Rehearsal::look_back(std::int64_t now_ns) {
  ipc::RingReader<wire::Telemetry, wire::spine_segment::kTelemetryDepth> reader(spine_.telemetry);
  reader.rewind(kMostPast);  // more records may arrive during the read
  std::uint32_t seen = 0;
  while (!reader.empty()) {
    if (!reader.next(record_) || !is_finite(record_, joints_)) continue;
    copy(record_, now_ns, joints_, (*past_)[seen++ % kMostPast]);
  }
  const std::uint32_t count = std::min(seen, kMostPast);
  if (seen > kMostPast) std::rotate(past_->begin(), past_->begin() + seen % kMostPast, past_->end());
  std::reverse(past_->begin(), past_->begin() + count);
  history_ = {past_->data(), count, joints_, dt_s_};
  return history_;
}

bool Rehearsal::dry_steps(const law::Resident& law, std::span<char> why) {
  scratch_ = law;
  Tick tick;
  for (std::uint64_t k = 0; k < 2 * law::kDryStepsAtRest; ++k) {
    law::dry_input(tick, k, joints_);
    sandbox_.enter(scratch_, tick);
    if (!contained(&call_step, &sandbox_, "step", why)) return false;
    sandbox_.keep_state(scratch_);
    char bad[64];
    if (law::outputs_are_finite(sandbox_.effort, sandbox_.probes, *law.descriptor, joints_, bad, sizeof bad)) continue;
    std::snprintf(why.data(), why.size(), "%s is not finite in dry step %u", bad, static_cast<unsigned>(k));
    return false;
  }
  return true;
}

bool Rehearsal::contained(contain::FaultBarrier::Call call, void* context, const char* what, std::span<char> why) {
  if (barrier_ == nullptr) {
    call(context);
    return true;
  }
  const contain::Failure failure = barrier_->run(monotonic_ns() + kMostNs, call, context);
  if (!failure) return true;
  const std::string_view kind = wire::to_string(failure.kind);
  std::snprintf(why.data(), why.size(), "%s failed before its first tick: %.*s", what, static_cast<int>(kind.size()),
                kind.data());
  return false;
}

}  // namespace lithe::load
