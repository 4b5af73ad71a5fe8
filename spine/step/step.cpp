// SPDX-License-Identifier: Apache-2.0
// The step, in the order of the timing figure: listen, step the law, guard, swap. Commands and plans are in listen.cpp,
// the work with the running law in laws.cpp.
#include "spine/step/step.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "spine/core/serialise.hpp"

namespace lithe::step {

using wire::EventKind;
namespace flag = wire::telemetry_flag;

ControlStep::ControlStep(const robot::RobotConfig& robot, law::Slot& slot, law::Sandbox& sandbox)
    : robot_(robot), drives_(robot), laws_({robot, slot, sandbox, guard_, mode_, in_, plan_.setpoint(), report_}) {
  plan_.configure(robot);
  guard_.configure(robot);
  in_.joints = static_cast<std::uint32_t>(robot.joints.size());
  in_.dt_s = static_cast<double>(std::llround(1e9 / robot.rate_hz)) * 1e-9;
  for (std::size_t i = 0; i < robot.inputs.size(); ++i) in_.input[i] = robot.inputs[i].value;
}

const Report& ControlStep::run(const Input& in, Host& host, hal::ActuatorCommand& command, wire::Telemetry& record)
    LITHE_RT {
  report_.begin(in.tick, in.now_ns);
  count_exchange(in, record);
  listen(in);  // e-stop, commands, plan
  look(in);    // what the law will see

  const std::int64_t law_from_ns = host.now_ns();
  laws_.step(host, record.probe);
  const std::int64_t guard_from_ns = host.now_ns();
  const guard::Verdict verdict = check(in, command);
  report_.guard_ns = host.now_ns() - guard_from_ns;
  report_.law_ns = guard_from_ns - law_from_ns;

  react(verdict);
  drives_.compose(in_, mode_, guard_, command);
  record.law_id = laws_.active_id();  // the law that ran in this tick
  laws_.check_probation(verdict);
  if (laws_.holds_here()) hold_here(in);
  laws_.swap(host);  // at the end of the tick: the next one runs the new law
  fill(in, record);
  return report_;
}

void ControlStep::count_exchange(const Input& in, wire::Telemetry& record) LITHE_RT {
  if (in.deadline_missed) {
    report_.flags |= flag::kDeadlineMissed;
    if (robot_.spine.miss_policy == robot::MissPolicy::stop)
      fail(wire::Fault::deadline_missed, "deadline_missed: a tick ended after the next release");
  }
  if (in.exchanged) {
    guard_.dispatched();
    drives_.dispatched();
    stale_ticks_ = 0;
    return;
  }
  ++record.late_samples;
  if (++stale_ticks_ == 1) report_.event(EventKind::sample_late, 0, 0, 0, "the bus exchange took over one period");
}

// A fault of the running robot: the latched safe stop.
void ControlStep::fail(wire::Fault fault, std::string_view text) LITHE_RT {
  if (!mode_.fail(fault)) return;
  report_.event(EventKind::safe_stop, static_cast<std::uint32_t>(fault), 0, 0, text);
}

void ControlStep::look(const Input& in) LITHE_RT {
  const hal::ActuatorState& sample = in.sample;
  if (!mode_.law_runs()) plan_.hold_at(sample.position_rad);  // so that arming starts where the joint is
  const plan::Setpoint& planned = plan_.sample(in.now_ns);
  const bool fresh = in.exchanged && sample.sample_ns != 0;  // 0 before the first exchange
  in_.tick = in.tick;
  in_.t_ns = in.now_ns;
  in_.input_age_s =
      inputs_ns_ == 0 ? std::numeric_limits<double>::infinity() : static_cast<double>(in.now_ns - inputs_ns_) * 1e-9;
  const bool inputs_stale = in_.input_age_s > robot_.brain.stale_after_s;
  in_.flags = (fresh ? 0 : kSampleStale) | (brain_stale_ ? kBrainStale : 0) | (inputs_stale ? kInputStale : 0);
  in_.sample_age_s = static_cast<double>(in.now_ns - sample.sample_ns) * 1e-9;
  in_.brain_age_s =
      in.brain_age_ns < 0 ? std::numeric_limits<double>::infinity() : static_cast<double>(in.brain_age_ns) * 1e-9;
  for (std::uint32_t j = 0; j < in_.joints; ++j) {
    in_.position_rad[j] = sample.position_rad[j];
    in_.velocity_rad_s[j] = sample.velocity_rad_s[j];
    in_.torque_nm[j] = sample.torque_nm[j];
    // For a joint that the guard has stopped, the setpoint is its measured position: so a law's integrator does not
    // wind up, and the law is not blamed for the error.
    const bool stopped = guard_.stopped(j);
    in_.setpoint_position_rad[j] = stopped ? sample.position_rad[j] : planned.position_rad[j];
    in_.setpoint_velocity_rad_s[j] = stopped ? 0.0 : planned.velocity_rad_s[j];
    in_.setpoint_acceleration_rad_s2[j] = stopped ? 0.0 : planned.acceleration_rad_s2[j];
  }
  static_assert(kMaxSensors == robot::kMaxSensors && kMaxSensors == wire::kNs);
  static_assert(kMaxInputs == robot::kMaxInputs && kMaxInputs == wire::kNin);
  in_.sensor = sample.sensor;
}

guard::Verdict ControlStep::check(const Input& in, JointCommands& out) LITHE_RT {
  const hal::ActuatorState& sample = in.sample;
  return guard_.check({mode_.mode(), stale_ticks_, in.brain_age_ns, sample.position_rad, sample.velocity_rad_s,
                       sample.status, laws_.effort(), in.now_ns - sample.sample_ns, &sample.torque_nm},
                      out);
}

void ControlStep::react(const guard::Verdict& verdict) LITHE_RT {
  report_.flags |= verdict.flags;
  if (verdict.recovered && !recovered_) report_.event(EventKind::recovered, 0, 0, 0, "every joint is inside");
  recovered_ = verdict.recovered;
  if (verdict.fault == wire::Fault::none || !mode_.can_fail()) return;
  EventText whose;
  name(verdict.fault, whose);
  for (const guard::Group& group : guard_.groups()) {
    if (!group.news) continue;
    EventText words;
    name(group, words);
    if (group.fault == verdict.fault) whose = words;
    if (guard_.groups().size() == 1) continue;
    report_.event(EventKind::group_stopped, static_cast<std::uint32_t>(group.fault), 0, group.joint, words.text());
  }
  if (!verdict.use_safe_law) return mode_.fail_in_part(verdict.fault);
  fail(verdict.fault, whose.text());
}

void ControlStep::name(const guard::Group& group, EventText& words) const LITHE_RT {
  const robot::JointConfig& joint = robot_.joints[group.joint];
  words << wire::to_string(group.fault) << " at joint " << joint.name;
  if (!joint.group.empty()) words << ", group " << joint.group;
  if (group.fault == wire::Fault::recover_failed) words << ": " << guard_.recovery().why_stuck(group.joint);
  tell_beyond(robot_, in_, group.joint, group.fault, words);
}

// A fault of the whole robot.
void ControlStep::name(wire::Fault fault, EventText& words) const LITHE_RT {
  words << wire::to_string(fault);
  if (fault == wire::Fault::sample_stale) {
    (words << ": ").number(stale_ticks_, 0) << " ticks in a row without a new sample, allowed ";
    words.number(robot_.spine.late_ticks_to_stop - 1, 0);
  } else if (fault == wire::Fault::brain_stale && std::isfinite(in_.brain_age_s)) {
    (words << ": no sign of life for ").number(in_.brain_age_s, 3) << " s, allowed ";
    words.number(robot_.brain.stale_after_s, 3);
  } else if (fault == wire::Fault::law_not_finite) {
    const std::size_t joint = guard_.not_finite_at(laws_.effort());
    if (joint < in_.joints) words << ": joint " << robot_.joints[joint].name;
  }
}

// Why a plan is refused; waypoints are counted from 1.
void ControlStep::name(const wire::PlanDecision& decided, EventText& words) const LITHE_RT {
  const wire::PlanReject reason = plan::reason_of(decided);
  if (reason == wire::PlanReject::none) return;
  words << wire::to_string(reason);
  const double waypoint = decided.waypoint + 1.0;
  if (decided.joint < in_.joints)
    (words << " at joint " << robot_.joints[decided.joint].name << ", waypoint ").number(waypoint, 0);
  switch (reason) {
    case wire::PlanReject::mode:
      words << ": in " << wire::to_string(mode_.mode()) << " no plan is followed, only in active";
      return;
    case wire::PlanReject::count:
      (words << ": ").number(decided.value, 0) << " waypoints, allowed 1 to ";
      words.number(decided.limit, 0);
      return;
    case wire::PlanReject::joints:
      (words << ": the plan has ").number(decided.value, 0) << ", the robot ";
      words.number(decided.limit, 0);
      return;
    case wire::PlanReject::time_order:
      (words << ": waypoint ").number(waypoint, 0) << " is ";
      words.number(-decided.value, 3) << " s before the one before it";
      return;
    case wire::PlanReject::too_old:
    case wire::PlanReject::too_far:
      (words << ": waypoint ").number(waypoint, 0) << " is ";
      words.number(std::abs(decided.value), 3) << (decided.value > 0 ? " s ahead of" : " s behind");
      (words << " the Spine's clock, allowed ").number(std::abs(decided.limit), 3);
      return;
    case wire::PlanReject::position_limit:
      (words << ": ").number(decided.value, 3) << " rad, allowed ";
      words.number(robot_.joints[decided.joint].position_min_rad, 3) << " to ";
      words.number(robot_.joints[decided.joint].position_max_rad, 3);
      return;
    case wire::PlanReject::velocity_limit:
      (words << ": ").number(decided.value, 3) << " rad/s, allowed ";
      words.number(decided.limit, 3);
      return;
    default:
      return;
  }
}

void ControlStep::fill(const Input& in, wire::Telemetry& record) const LITHE_RT {
  const hal::ActuatorState& sample = in.sample;
  record.tick = in.tick;
  record.sample_ns = sample.sample_ns;
  record.brain_age_ns = in.brain_age_ns;
  record.mode = static_cast<std::uint32_t>(mode_.mode());
  record.fault = static_cast<std::uint32_t>(mode_.fault());
  record.flags = report_.flags | (brain_stale_ ? flag::kBrainStale : 0);
  record.plan_state = static_cast<std::uint32_t>(plan_.setpoint().state);
  record.plan_id = plan_.plan_id();
  for (std::uint32_t j = 0; j < in_.joints; ++j) {
    record.position_rad[j] = sample.position_rad[j];
    record.velocity_rad_s[j] = sample.velocity_rad_s[j];
    record.torque_nm[j] = sample.torque_nm[j];
    record.setpoint_position_rad[j] = in_.setpoint_position_rad[j];
    record.setpoint_velocity_rad_s[j] = in_.setpoint_velocity_rad_s[j];
    record.setpoint_acceleration_rad_s2[j] = in_.setpoint_acceleration_rad_s2[j];
    record.law_torque_nm[j] = wanted_nm(laws_.effort(), in_, j);
    record.command_torque_nm[j] = guard_.expected_torque_nm(j);
    record.joint_status[j] = sample.status[j];
    record.joint_fault[j] = static_cast<std::uint32_t>(guard_.joint_fault(j));
    record.joint_rung[j] = static_cast<std::uint32_t>(guard_.rung(j));
    const hal::DriveReport& drive = sample.drive[j];
    record.drive_state[j] = static_cast<std::uint32_t>(drive.state);
    record.drive_current_a[j] = drive.current_a;
    record.drive_voltage_v[j] = drive.voltage_v;
    record.drive_power_w[j] = drive.power_w;
    record.drive_temperature_degc[j] = drive.temperature_degc;
  }
  record.sensor = sample.sensor;
  record.input = in_.input;
  record.input_age_ns = inputs_ns_ == 0 ? -1 : in.now_ns - inputs_ns_;
  record.setpoint_age_ns = plan_.held_for_ns(in.now_ns);
}

// Commit, one atomic exchange: the staged law runs from the next tick on.
void Laws::swap(Host& host) LITHE_RT {
  if (shadow_.law() != nullptr) return step_shadow(host);
  law::Resident* candidate = slot_.take();
  if (candidate == nullptr) return;
  if (candidate->terms.shadow_ticks > 0) return start_shadow(*candidate);
  commit(*candidate, law::Carry::named);
}

void Laws::commit(law::Resident& candidate, law::Carry carry) LITHE_RT {
  // Values on probation leave with the law: an earlier law runs with those that were confirmed.
  if (probation_.of_params()) slot_.active()->restore_trusted_params();
  const law::Commit done = slot_.commit(candidate, carry);
  const bool follows = done.previous_id != 0;
  candidate.unproven = follows && candidate.terms.probation_ticks > 0;
  begin_law(follows ? candidate.terms.blend_ticks : 0);
  probation_.start(candidate, in_, false);
  report_.flags |= flag::kSwapCommitted;
  // Before the commit's event: the supervisor answers the swap when it reads that, with the fields that it knows then.
  tell_not_carried(candidate, done.not_carried);
  report_.event(EventKind::law_committed, done.law_id, done.request_id, static_cast<double>(done.fields_carried),
                "runs from the next tick");
  report_.params_changed = true;
}

void Laws::start_shadow(law::Resident& candidate) LITHE_RT {
  serialise_core();
  law::Commit carried;
  slot_.carry_into(candidate, carried);
  shadow_.start(candidate, report_.tick(), in_.joints);
  report_.event(EventKind::shadow_started, candidate.law_id, candidate.request_id, candidate.terms.shadow_ticks,
                "runs beside the active law");
  tell_not_carried(candidate, carried.not_carried);
}

// Runs the shadow candidate, after the active law's output has been handed over.
void Laws::step_shadow(Host& host) LITHE_RT {
  if (!mode_.law_runs()) return end_shadow(Shadow::Opinion::refuse, "no law runs any more: arm, then swap again");
  if ((report_.flags & (flag::kRolledBack | flag::kLawFaulted)) != 0)
    return end_shadow(Shadow::Opinion::refuse, "the active law was replaced");
  if (guard_.any_stopped())
    return end_shadow(Shadow::Opinion::refuse, "a part of the robot is stopped: nothing can be compared there");
  report_.flags |= flag::kShadowing;
  const std::int64_t from_ns = host.now_ns();
  const Run ran = run(*shadow_.law(), shadow_.effort, host);
  if (ran.failure) {
    shadow_.fail();
    const EventText why = in_words(ran);
    return end_shadow(Shadow::Opinion::refuse, why.text());
  }
  const std::int64_t took_ns = host.now_ns() - from_ns;
  switch (shadow_.compare(in_, effort_, took_ns)) {
    case Shadow::Opinion::go_on:
      report_.shadow_changed = true;
      return;
    case Shadow::Opinion::refuse:
      return end_shadow(Shadow::Opinion::refuse, "it disagrees with the active law by more than the tolerance");
    case Shadow::Opinion::promote:
      return end_shadow(Shadow::Opinion::promote, "it agrees with the active law");
    case Shadow::Opinion::measured:
      return end_shadow(Shadow::Opinion::measured, "compared as long as asked; it was not to be promoted");
  }
}

void Laws::end_shadow(Shadow::Opinion opinion, std::string_view why) LITHE_RT {
  law::Resident& candidate = *shadow_.law();
  report_.shadow_changed = true;
  report_.event(EventKind::shadow_ended, static_cast<std::uint32_t>(opinion), candidate.request_id,
                shadow_.largest_difference_nm(), why);
  shadow_.end();
  if (opinion == Shadow::Opinion::promote)
    return commit(candidate, law::Carry::none);  // its state is warm: it ran in the shadow
  slot_.refuse(candidate);
}

// Synchronises this core's instruction cache, because the slot may have held another law's code; then starts the blend.
void Laws::begin_law(std::uint32_t blend_ticks) LITHE_RT {
  serialise_core();
  bumpless_.start(blend_ticks);
}

void Laws::mark(std::string_view why) LITHE_RT {
  law::Resident& law = *slot_.active();
  law.marked = true;
  report_.event(EventKind::law_marked, law.law_id, law.request_id, 0, why);
}

// It gave power to the joint. What a law does about noise at rest is far below this share.
bool Laws::drove_out(std::uint32_t j) const LITHE_RT {
  constexpr double kOfFullPower = 1e-4;
  return power_w_[j] > kOfFullPower * robot_.joints[j].torque_max_nm * robot_.joints[j].velocity_max_rad_s;
}

// Of what the joint can do only: a law may want any torque.
void Laws::see_power() LITHE_RT {
  for (std::uint32_t j = 0; j < in_.joints; ++j) {
    const double most_nm = robot_.joints[j].torque_max_nm;
    const double power_w = std::clamp(wanted_nm(effort_, in_, j), -most_nm, most_nm) * in_.velocity_rad_s[j];
    if (std::isfinite(power_w)) power_w_[j] = power_w + (power_w_[j] - power_w) * forget_power_;
  }
}

}  // namespace lithe::step
