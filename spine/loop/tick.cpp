// SPDX-License-Identifier: Apache-2.0
// The tick, in the order of the timing figure: hand over, listen, step the law, guard, swap, publish. Its work with
// laws is in laws.cpp.
#include <algorithm>
#include <limits>

#include "spine/loop/spine.hpp"
#include "spine/loop/transport.hpp"

namespace lithe::loop {

using wire::EventKind;
namespace flag = wire::telemetry_flag;

void Spine::tick(std::int64_t release_ns, std::int64_t woke_ns, std::uint32_t skipped) LITHE_RT {
  // Durations come from the clock; the time itself is an argument, so that a test can choose it.
  const std::int64_t from_ns = clock_.now_ns();
  out_.record().tick = ++tick_;
  count_release(release_ns, woke_ns, skipped);
  exchange(woke_ns);  // u_k leaves, x_k is here
  const std::int64_t handed_ns = clock_.now_ns();

  listen(woke_ns);  // e-stop, commands, plan
  look(woke_ns);    // what the law will see

  const std::int64_t law_from_ns = clock_.now_ns();
  step_law(woke_ns);
  const std::int64_t guard_from_ns = clock_.now_ns();
  const guard::Verdict verdict = check(woke_ns);
  const std::int64_t guard_to_ns = clock_.now_ns();

  react(verdict, woke_ns);
  compose();  // u_{k+1}, for the next release
  durations_.handoff_ns = inline_actuators_ == nullptr ? handed_ns - from_ns : served_ns_ - last_from_ns_;
  last_from_ns_ = from_ns;
  durations_.law_ns = guard_from_ns - law_from_ns;
  durations_.guard_ns = guard_to_ns - guard_from_ns;
  judge_law(verdict, woke_ns);
  swap(woke_ns);  // at the end of the tick: the next one runs the new law
  publish(verdict, release_ns);

  durations_.tick_ns = clock_.now_ns() - from_ns;
  overran_ = durations_.release_jitter_ns + durations_.tick_ns > period_ns_;
}

// Skipped releases and overrun deadlines are counted here and nowhere else.
void Spine::count_release(std::int64_t release_ns, std::int64_t woke_ns, std::uint32_t skipped) LITHE_RT {
  durations_.release_jitter_ns = woke_ns - release_ns;
  flags_ = 0;
  if (skipped == 0 && !overran_) return;
  flags_ |= flag::kDeadlineMissed;
  out_.skipped(skipped, durations_.release_jitter_ns, period_ns_);
  out_.event(EventKind::deadline_missed, woke_ns, skipped, 0, static_cast<double>(durations_.tick_ns),
             skipped > 0 ? "releases were skipped" : "the tick ended after its deadline");
  if (robot_.spine.miss_policy == robot::MissPolicy::stop && mode_.fail(wire::Fault::deadline_missed)) {
    out_.event(EventKind::safe_stop, woke_ns, static_cast<std::uint32_t>(wire::Fault::deadline_missed), 0, 0, "");
  }
}

// Hands u_k over and takes x_k. While the Transport is still busy, this tick sends no command and gets no sample.
void Spine::exchange(std::int64_t woke_ns) LITHE_RT {
  fresh_ = handover_.idle();
  if (fresh_) {
    sample_ = &handover_.latest_sample();
    fresh_ = sample_->sample_ns != 0;  // 0 before the first exchange
    durations_.bus_ns = sample_->bus_ns;
    handover_.dispatch();
    guard_.dispatched();
    ticks_off_ = all_off_ ? ticks_off_ + 1 : 0;
    stale_ticks_ = 0;
    return;
  }
  flags_ |= flag::kSampleStale;
  ++out_.record().late_samples;
  if (++stale_ticks_ == 1)
    out_.event(EventKind::sample_late, woke_ns, 0, 0, 0, "the bus exchange took over one period");
}

void Spine::look(std::int64_t now_ns) LITHE_RT {
  if (!mode_.law_runs()) plan_.hold_at(sample_->position_rad);  // so that arming starts where the joint is
  plan_.sample(now_ns, setpoint_);
  planned_rad_ = setpoint_.position_rad;
  if (guard_.any_stopped()) forget_stopped_joints();
  in_.tick = tick_;
  in_.t_ns = now_ns;
  in_.flags = (fresh_ ? 0 : kSampleStale) | (brain_stale_ ? kBrainStale : 0);
  in_.sample_age_s = static_cast<double>(now_ns - sample_->sample_ns) * 1e-9;
  const std::int64_t brain_age_ns = out_.record().brain_age_ns;
  in_.brain_age_s =
      brain_age_ns < 0 ? std::numeric_limits<double>::infinity() : static_cast<double>(brain_age_ns) * 1e-9;
  for (std::uint32_t j = 0; j < joints_; ++j) {
    in_.position_rad[j] = sample_->position_rad[j];
    in_.velocity_rad_s[j] = sample_->velocity_rad_s[j];
    in_.torque_nm[j] = sample_->torque_nm[j];
    in_.setpoint_position_rad[j] = setpoint_.position_rad[j];
    in_.setpoint_velocity_rad_s[j] = setpoint_.velocity_rad_s[j];
    in_.setpoint_acceleration_rad_s2[j] = setpoint_.acceleration_rad_s2[j];
  }
  static_assert(kMaxSensors == robot::kMaxSensors && kMaxSensors == wire::kNs);
  in_.sensor = sample_->sensor;
}

// For a joint that the guard has stopped, the setpoint is its measured position: so a law's integrator does not wind
// up, and the law is not blamed for the error.
void Spine::forget_stopped_joints() LITHE_RT {
  for (std::uint32_t j = 0; j < joints_; ++j) {
    if (!guard_.stopped(j)) continue;
    setpoint_.position_rad[j] = sample_->position_rad[j];
    setpoint_.velocity_rad_s[j] = setpoint_.acceleration_rad_s2[j] = 0;
  }
}

guard::Verdict Spine::check(std::int64_t now_ns) LITHE_RT {
  return guard_.check({mode_.mode(), stale_ticks_, out_.record().brain_age_ns, sample_->position_rad,
                       sample_->velocity_rad_s, sample_->status, effort_, now_ns - sample_->sample_ns},
                      output_);
}

void Spine::react(const guard::Verdict& verdict, std::int64_t now_ns) LITHE_RT {
  flags_ |= verdict.flags;
  if (verdict.recovered && !recovered_) out_.event(EventKind::recovered, now_ns, 0, 0, 0, "every joint is inside");
  recovered_ = verdict.recovered;
  if (verdict.fault == wire::Fault::none || !mode_.can_fail()) return;
  Words whose;
  whose << wire::to_string(verdict.fault);
  for (const guard::Group& group : guard_.groups()) {
    if (!group.news) continue;
    Words words;
    name(group, words);
    if (group.fault == verdict.fault) whose = words;
    if (guard_.groups().size() == 1) continue;
    out_.event(EventKind::group_stopped, now_ns, static_cast<std::uint32_t>(group.fault), 0, group.joint, words.text());
  }
  if (!verdict.use_safe_law) return mode_.fail_in_part(verdict.fault);
  mode_.fail(verdict.fault);
  out_.event(EventKind::safe_stop, now_ns, static_cast<std::uint32_t>(verdict.fault), 0, 0, whose.text());
}

void Spine::name(const guard::Group& group, Words& words) const LITHE_RT {
  const robot::JointConfig& joint = robot_.joints[group.joint];
  words << wire::to_string(group.fault) << " at joint " << joint.name;
  if (!joint.group.empty()) words << ", group " << joint.group;
  if (group.fault == wire::Fault::recover_failed) words << ": " << guard_.recovery().why_stuck(group.joint);
}

hal::DriveAction Spine::action_of(std::uint32_t j) const LITHE_RT {
  if (!mode_.energised() && !mode_.damps()) return hal::DriveAction::off;
  switch (output_.rung[j]) {  // the e-stop only goes down the ladder
    case wire::Rung::brake:
      return hal::DriveAction::brake;
    case wire::Rung::off:
      return hal::DriveAction::off;
    default:
      return mode_.damps() ? hal::DriveAction::damp : hal::DriveAction::torque;
  }
}

void Spine::compose() LITHE_RT {
  hal::ActuatorCommand& command = handover_.next_command();
  command.tick = tick_ + 1;
  command.joints = joints_;
  command.clear_faults = clear_ticks_left_ > 0 && mode_.mode() == wire::Mode::disarmed;
  command.reset_simulation = reset_simulation_;
  reset_simulation_ = false;
  clear_ticks_left_ = command.clear_faults ? clear_ticks_left_ - 1 : 0;  // later faults need another reset
  all_off_ = !mode_.energised() && !mode_.damps();
  for (std::uint32_t j = 0; j < joints_; ++j) {
    command.action[j] = action_of(j);
    command.torque_nm[j] = output_.torque_nm[j];
    command.position_rad[j] = output_.position_rad[j];
    command.velocity_rad_s[j] = output_.velocity_rad_s[j];
    command.kp_nm_rad[j] = output_.kp_nm_rad[j];
    command.kd_nm_s_rad[j] = output_.kd_nm_s_rad[j];
    command.max_torque_nm[j] = output_.max_torque_nm[j];
  }
}

void Spine::publish(const guard::Verdict& verdict, std::int64_t release_ns) LITHE_RT {
  wire::Telemetry& record = out_.record();
  record.release_ns = release_ns;
  record.sample_ns = sample_->sample_ns;
  record.mode = static_cast<std::uint32_t>(mode_.mode());
  record.fault = static_cast<std::uint32_t>(mode_.fault());
  record.flags = flags_ | (brain_stale_ ? flag::kBrainStale : 0) | verdict.flags;
  record.plan_state = static_cast<std::uint32_t>(setpoint_.state);
  record.plan_id = plan_.plan_id();
  std::copy(probes_.begin(), probes_.end(), record.probe.begin());
  const JointArray& torque_nm = guard_.expected_torque_nm();
  for (std::uint32_t j = 0; j < joints_; ++j) {
    record.position_rad[j] = sample_->position_rad[j];
    record.velocity_rad_s[j] = sample_->velocity_rad_s[j];
    record.torque_nm[j] = sample_->torque_nm[j];
    record.setpoint_position_rad[j] = setpoint_.position_rad[j];
    record.setpoint_velocity_rad_s[j] = setpoint_.velocity_rad_s[j];
    record.command_torque_nm[j] = torque_nm[j];
    record.joint_status[j] = sample_->status[j];
    record.joint_fault[j] = static_cast<std::uint32_t>(guard_.joint_fault(j));
    record.joint_rung[j] = static_cast<std::uint32_t>(output_.rung[j]);
    const hal::DriveReport& drive = sample_->drive[j];
    record.drive_state[j] = static_cast<std::uint32_t>(drive.state);
    record.drive_current_a[j] = drive.current_a;
    record.drive_voltage_v[j] = drive.voltage_v;
    record.drive_power_w[j] = drive.power_w;
    record.drive_temperature_degc[j] = drive.temperature_degc;
  }
  record.sensor = sample_->sensor;
  out_.publish(durations_, fresh_);
  const law::Resident* law = slot_.active();
  if (law != nullptr && tick_ % state_ticks_ == 0) out_.state(*law);
}

void Spine::serve_inline() LITHE_RT {
  if (inline_actuators_ == nullptr || !handover_.pending()) return;
  served_ns_ = clock_.now_ns();
  serve_once(handover_, *inline_actuators_, clock_.raw());
}

}  // namespace lithe::loop
