// SPDX-License-Identifier: Apache-2.0
#include "spine/step/laws.hpp"

#include <algorithm>
#include <cmath>

#include "spine/core/serialise.hpp"

namespace lithe::step {

using contain::Failure;
using wire::EventKind;
using wire::LawFaultKind;
namespace flag = wire::telemetry_flag;

namespace {

void copy_effort(const Effort& from, Effort& to, std::uint32_t joints) LITHE_RT {
  copy_joints(from.torque_nm, to.torque_nm, joints);
  copy_joints(from.position_rad, to.position_rad, joints);
  copy_joints(from.velocity_rad_s, to.velocity_rad_s, joints);
  copy_joints(from.kp_nm_rad, to.kp_nm_rad, joints);
  copy_joints(from.kd_nm_s_rad, to.kd_nm_s_rad, joints);
}

// The name of an output of this joint that is not finite, or of what makes its torque so.
std::string_view not_finite_in(const Effort& effort, std::size_t joint) LITHE_RT {
  if (!std::isfinite(effort.torque_nm[joint])) return "torque_nm";
  if (!std::isfinite(effort.velocity_rad_s[joint])) return "velocity_rad_s";
  if (!std::isfinite(effort.kp_nm_rad[joint])) return "kp_nm_rad";
  if (!std::isfinite(effort.kd_nm_s_rad[joint])) return "kd_nm_s_rad";
  return std::isinf(effort.position_rad[joint]) ? "position_rad" : "the torque of its gains";
}

bool is_runaway(wire::Fault fault) LITHE_RT {
  return fault == wire::Fault::position_limit || fault == wire::Fault::velocity_limit;
}

}  // namespace

void tell_beyond(const robot::RobotConfig& robot, const Tick& in, std::size_t joint, wire::Fault fault,
                 EventText& words) LITHE_RT {
  const robot::JointConfig& config = robot.joints[joint];
  const double overrun_rad = robot.guard.position_overrun_rad;
  if (fault == wire::Fault::position_limit) {
    (words << ": ").number(in.position_rad[joint], 3) << " rad, allowed ";
    words.number(config.position_min_rad - overrun_rad, 3) << " to ";
    words.number(config.position_max_rad + overrun_rad, 3);
  } else if (fault == wire::Fault::velocity_limit) {
    (words << ": ").number(in.velocity_rad_s[joint], 1) << " rad/s, allowed ";
    words.number(config.velocity_max_rad_s * robot.guard.velocity_overrun, 1);
  }
}

Laws::Laws(const Wiring& wiring)
    : robot_(wiring.robot),
      slot_(wiring.slot),
      sandbox_(wiring.sandbox),
      guard_(wiring.guard),
      mode_(wiring.mode),
      in_(wiring.in),
      report_(wiring.report),
      period_ns_(std::llround(1e9 / wiring.robot.rate_hz)),
      budget_ns_(std::llround(static_cast<double>(period_ns_) * wiring.robot.swap.budget_share)) {
  probation_.configure(wiring.robot);
  constexpr double kPowerMemoryS = 0.1;
  forget_power_ = std::exp(-1.0 / (kPowerMemoryS * wiring.robot.rate_hz));
}

void Laws::step(Host& host, std::array<double, kMaxProbes>& probes) LITHE_RT {
  probes.fill(0.0);
  if (slot_.active() == nullptr || !mode_.law_runs()) {
    bumpless_.start(0);  // the rest of a blend belongs to the old motion
    return effort_.clear(in_.joints);
  }
  const Run first = run(*slot_.active(), effort_, host);
  if (first.failure && !fall_back(first, host)) return effort_.clear(in_.joints);
  probes = sandbox_.probes;
  if (bumpless_.fading()) report_.flags |= flag::kBlending;
  bumpless_.apply(in_, guard_, effort_);
}

// Runs `law` on copies of its inputs. Its state and output are kept only if it did not fail.
Laws::Run Laws::run(law::Resident& law, Effort& effort, Host& host) LITHE_RT {
  if (law.since_ns == 0) law.since_ns = in_.t_ns;
  in_.t_s = static_cast<double>(in_.t_ns - law.since_ns) * 1e-9;
  sandbox_.enter(law, in_);
  const std::int64_t from_ns = host.now_ns();
  const std::int64_t budget_ns = law.terms.budget_ns > 0 ? law.terms.budget_ns : budget_ns_;
  const std::int64_t most_ns = std::min(budget_ns, period_ns_);
  const Failure failure = host.run(sandbox_, from_ns + most_ns);
  if (failure) return {failure, from_ns, host.now_ns() - from_ns, most_ns};
  const bool sound_input = all_finite(in_.position_rad, in_.joints) && all_finite(in_.velocity_rad_s, in_.joints) &&
                           all_finite(in_.torque_nm, in_.joints);
  // A non-finite output that comes from a broken sensor is not a law fault: the guard handles it. The state of this
  // step is not kept.
  const std::size_t odd = sound_input ? not_finite_at(sandbox_.effort) : kMaxJoints;
  if (odd != kMaxJoints) {
    return {.failure = {LawFaultKind::not_finite, 0, 0},
            .from_ns = from_ns,
            .joint = odd,
            .output = not_finite_in(sandbox_.effort, odd)};
  }
  if (sound_input) sandbox_.keep_state(law);
  copy_effort(sandbox_.effort, effort, in_.joints);
  return {{}, from_ns};
}

// The first joint for which an output is not finite, or the torque that it makes with the drive's own PD.
std::size_t Laws::not_finite_at(const Effort& effort) const LITHE_RT {
  std::size_t odd = guard_.not_finite_at(effort);
  for (std::size_t j = in_.joints; j-- > 0;)
    if (j < odd && !guard_.stopped(j) && !std::isfinite(wanted_nm(effort, in_, j))) odd = j;
  return odd;
}

// Runs the law before the failed one in this same tick. False: there is none, or it fails too; then the safe law takes
// over.
bool Laws::fall_back(const Run& first, Host& host) LITHE_RT {
  const LawFaultKind kind = first.failure.kind;
  const EventText why = in_words(first);
  wire::LawFault fault = fault_of(first.failure);
  const Back back = step_back();
  if (back == Back::nowhere) {
    report(fault, 0, host.now_ns() - first.from_ns, why.text());
    stop_for(kind, why.text());
    mark(why.text());
    return false;
  }
  const Run second = run(*slot_.active(), effort_, host);
  report(fault, slot_.active()->law_id, host.now_ns() - first.from_ns, why.text());
  tell_back(back, why.text());
  if (!second.failure) return true;
  // At most two laws per tick: a third would cost a third time budget.
  const LawFaultKind its_kind = second.failure.kind;
  const EventText its_why = in_words(second);
  fault = fault_of(second.failure);
  report(fault, 0, host.now_ns() - second.from_ns, its_why.text());
  const Back further = step_back();
  tell_back(further, its_why.text());  // the law that runs after a reset
  stop_for(its_kind, its_why.text());
  if (further == Back::nowhere) mark(its_why.text());
  return false;
}

// Rollback without a law fault: from the next tick on the law before the active one runs again.
void Laws::replace(const Probation::News& why) LITHE_RT {
  const EventText words = in_words(why);
  wire::LawFault fault = fault_of({why.kind, 0, 0});
  const Back back = step_back();
  report(fault, back == Back::nowhere ? 0 : slot_.active()->law_id, 0, words.text());
  if (back != Back::nowhere) return tell_back(back, words.text());
  stop_for(why.kind, words.text());
  if (why.kind != LawFaultKind::guard_stopped || drove_out(why.evidence.joint)) mark(words.text());
}

// Goes back by one step: to the previous parameters while the last ones are on probation, else to the law before the
// active one, whose own state is used, if there is one.
Laws::Back Laws::step_back() LITHE_RT {
  if (probation_.of_params()) {
    probation_.end_params(in_);
    slot_.active()->restore_trusted_params();
    report_.params_changed = true;
    return Back::params;
  }
  law::FieldBits mended = 0;
  std::uint32_t steps = 1;
  while (slot_.before(steps) != nullptr && slot_.before(steps)->marked) ++steps;  // at most law::kHistory
  const bool back = slot_.rollback(law::Carry::none, steps, &mended);
  probation_.start(*slot_.active(), in_, true);  // without another law, the same one runs after a reset
  if (!back) return Back::nowhere;
  report_.flags |= flag::kRolledBack;
  begin_law(0);
  report_.params_changed = true;
  tell_not_carried(*slot_.active(), mended);
  return Back::law;
}

// The State fields that start from their defaults, because the old value was not usable.
void Laws::tell_not_carried(const law::Resident& law, law::FieldBits fields) LITHE_RT {
  if (fields == 0) return;
  EventText words;
  std::uint32_t count = 0;
  for (std::uint32_t i = 0; i < law.descriptor->state_count && i < kMaxStateFields; ++i) {
    if ((fields >> i & 1) == 0) continue;
    const auto& name = law.descriptor->state[i].name;
    const auto length = static_cast<std::size_t>(std::find(std::begin(name), std::end(name), '\0') - std::begin(name));
    words << (count++ == 0 ? "" : ", ") << std::string_view(name, length);
  }
  words << ": no finite number; starts from its default";
  report_.event(EventKind::state_not_carried, law.law_id, law.request_id, count, words.text());
}

void Laws::begin() LITHE_RT {
  law::Resident& law = *slot_.active();
  law.marked = false;
  tell_not_carried(law, law::mend_state(*law.descriptor, law.state.data()));
}

void Laws::tell_back(Back back, std::string_view why) LITHE_RT {
  const law::Resident& law = *slot_.active();
  if (back == Back::params)
    report_.event(EventKind::params_reverted, law.law_id, probation_.params_request_id(), 0, why);
  else if (back == Back::law)
    report_.event(EventKind::law_rolled_back, law.law_id, law.request_id, 1, why);
}

void Laws::stop_for(LawFaultKind kind, std::string_view why) LITHE_RT {
  const wire::Fault fault = kind == LawFaultKind::not_finite ? wire::Fault::law_not_finite : wire::Fault::law_faulted;
  if (kind == LawFaultKind::not_finite) report_.flags |= flag::kNotFinite;
  if (mode_.fail(fault)) report_.event(EventKind::safe_stop, static_cast<std::uint32_t>(fault), 0, 0, why);
}

// Copied from the active law: the Loader may unload it as soon as another one is active.
wire::LawFault Laws::fault_of(const Failure& failure) const LITHE_RT {
  const law::Resident& law = *slot_.active();
  wire::LawFault fault{};
  fault.tick = report_.tick();
  fault.t_ns = report_.now_ns();
  fault.request_id = law.request_id;
  fault.kind = static_cast<std::uint32_t>(failure.kind);
  fault.law_id = law.law_id;
  fault.pc = failure.pc;
  fault.address = failure.address;
  fault.slot = law.slot;
  const std::uint64_t offset = failure.pc - law.code_address;
  fault.pc_offset = law.code_address != 0 && offset < law.code_bytes ? static_cast<std::uint32_t>(offset) : 0;
  return fault;
}

void Laws::report(wire::LawFault& fault, std::uint32_t to_law_id, std::int64_t took_ns, std::string_view why) LITHE_RT {
  fault.to_law_id = to_law_id;
  fault.took_ns = clamp_ns(took_ns);
  report_.law_fault(fault);
  report_.flags |= flag::kLawFaulted;
  report_.event(EventKind::law_faulted, fault.kind, fault.request_id, static_cast<double>(fault.took_ns) * 1e-3, why);
}

// A plan asks the joint to where the guard weakens the torque that every law needs there, and there it is.
bool Laws::asked_into_soft_stop(std::uint32_t j, double torque_nm) const LITHE_RT {
  const robot::JointConfig& joint = robot_.joints[j];
  const double soft_rad = robot_.guard.soft_stop_rad, asked_rad = in_.setpoint_position_rad[j];
  const double from_rad = joint.position_max_rad - soft_rad, to_rad = joint.position_min_rad + soft_rad;
  return torque_nm > 0 ? std::min(asked_rad, in_.position_rad[j]) > from_rad
                       : std::max(asked_rad, in_.position_rad[j]) < to_rad;
}

void Laws::check_probation(const guard::Verdict& verdict) LITHE_RT {
  if (slot_.active() == nullptr) return;
  // The guard has just stopped joints because of this law: it must not be the law that runs after the reset.
  const auto ran_away = [](const guard::Group& group) { return group.news && is_runaway(group.fault); };
  const auto groups = guard_.groups();
  const auto stopped = std::ranges::find_if(groups, ran_away);
  if (!verdict.recovering && stopped != groups.end()) {
    const Probation::News news{.kind = LawFaultKind::guard_stopped, .evidence = {.joint = stopped->joint}};
    if (probation_.on()) return replace(news);
    if (drove_out(stopped->joint)) mark(in_words(news).text());
  }
  if (marked()) report_.flags |= flag::kLawMarked;
  if (!mode_.law_runs()) return probation_.rest(in_.joints, mode_.fault() != wire::Fault::none);
  see_power();
  const bool soft_start = (verdict.flags & flag::kSoftStarting) != 0;
  if (probation_.on()) report_.flags |= flag::kOnProbation;
  if (probation_.of_params()) report_.flags |= flag::kParamsOnProbation;
  JointArray torque_nm;
  std::array<std::uint32_t, kMaxJoints> clamped{};
  std::array<bool, kMaxJoints> joint_stopped{};
  bool held_back = false;
  for (std::uint32_t j = 0; j < in_.joints; ++j) {
    torque_nm[j] = wanted_nm(effort_, in_, j);
    joint_stopped[j] = guard_.stopped(j);
    clamped[j] = guard_.law_flags(j) & (Probation::kClamped | Probation::kSlewed);
    if (soft_start && (clamped[j] & flag::kTorqueClamped) != 0) {
      held_back = true;
      clamped[j] &= ~flag::kTorqueClamped;  // of the start, not the law
    }
    if (asked_into_soft_stop(j, torque_nm[j])) clamped[j] &= ~flag::kPositionClamped;  // of the plan
  }
  const Probation::News news = probation_.watch({in_, torque_nm, report_.law_ns, clamped, joint_stopped, held_back});
  if (probation_.unproven()) report_.flags |= flag::kUnproven;
  tell_probation(news);
  if (news.kind != LawFaultKind::none) replace(news);
}

void Laws::tell_probation(const Probation::News& news) LITHE_RT {
  const law::Resident& law = *slot_.active();
  constexpr std::string_view kAtRest = "the robot moved too little to judge by; its probation goes on";
  if (news.law_unproven) report_.event(EventKind::law_unproven, law.law_id, law.request_id, 0, kAtRest);
  const std::uint64_t params_id = probation_.params_request_id();
  if (news.params_unproven) report_.event(EventKind::law_unproven, law.law_id, params_id, 1, kAtRest);
  if (news.params_confirmed)
    report_.event(EventKind::params_confirmed, law.law_id, params_id, 0, "their probation is over");
  if (!news.law_confirmed) return;
  slot_.active()->unproven = false;
  report_.event(
      EventKind::law_confirmed, law.law_id, law.request_id, 0,
      guard_.any_stopped() ? "its probation is over, with a part of the robot stopped" : "its probation is over");
}

// What the law saw of a joint, or a sensor that was not valid.
void Laws::tell_inputs(std::size_t joint, EventText& words) const LITHE_RT {
  for (std::size_t i = 0; i < robot_.sensors.size() && i < in_.sensor.size(); ++i) {
    if (std::isnan(in_.sensor[i])) {
      words << "sensor " << robot_.sensors[i].name << " was NaN";
      return;
    }
  }
  (words << "at ").number(in_.position_rad[joint], 3) << " rad, ";
  words.number(in_.velocity_rad_s[joint], 2) << " rad/s, ";
  words.number(in_.torque_nm[joint], 2) << " N m, setpoint ";
  words.number(in_.setpoint_position_rad[joint], 3);
}

// "overran: ended after 812.0 us, allowed 800.0"; "not_finite: joint elbow, torque_nm; at 0.100 rad, 3.20 rad/s, 0.15
// N m, setpoint 0.250".
EventText Laws::in_words(const Run& failed) const LITHE_RT {
  EventText words;
  words << wire::to_string(failed.failure.kind);
  if (failed.failure.kind == LawFaultKind::overran) {
    (words << ": ended after ").number(1e-3 * static_cast<double>(failed.took_ns), 1) << " us, allowed ";
    words.number(1e-3 * static_cast<double>(failed.budget_ns), 1);
  } else if (failed.joint < robot_.joints.size()) {
    words << ": joint " << robot_.joints[failed.joint].name << ", " << failed.output << "; ";
    tell_inputs(failed.joint, words);
  }
  return words;
}

// What the guard clamps now, with the value and its limit: "wants 12.000 N m of 0.600".
void Laws::tell_clamped(const Probation::Evidence& evidence, EventText& words) const LITHE_RT {
  const robot::JointConfig& joint = robot_.joints[evidence.joint];
  const double torque_nm = wanted_nm(effort_, in_, evidence.joint), speed_rad_s = in_.velocity_rad_s[evidence.joint];
  // The guard brakes ahead of both limits, with one flag: at half the speed limit the speed is the more telling one.
  const bool fast = std::abs(speed_rad_s) > 0.5 * joint.velocity_max_rad_s;
  if (evidence.clamped == Probation::kSlewed) {
    (words << "torque_slew_nm_s is ").number(joint.torque_slew_nm_s, 0);
  } else if ((evidence.clamped & flag::kTorqueClamped) != 0) {
    (words << "wants ").number(torque_nm, 3) << " N m of ";
    words.number(joint.torque_max_nm, 3);
  } else if ((evidence.clamped & flag::kVelocityClamped) != 0 || fast) {
    (words << "at ").number(speed_rad_s, 1) << " rad/s of ";
    words.number(joint.velocity_max_rad_s, 1);
  } else {
    (words << "at ").number(in_.position_rad[evidence.joint], 3) << " rad of ";
    words.number(torque_nm > 0 ? joint.position_max_rad : joint.position_min_rad, 3);
  }
}

// "oscillating: joint wrist, 31 Hz, swings of 20.00, allowed 1.50 rad/s"; "tracking_lost: joint elbow, error 0.312 rad,
// allowed 0.150"; "guard_busy: joint
// elbow clamped in 80.1 % of ticks, allowed 80: wants 12.000 N m of 0.600".
EventText Laws::in_words(const Probation::News& news) const LITHE_RT {
  const Probation::Evidence& evidence = news.evidence;
  EventText words;
  words << wire::to_string(news.kind);
  switch (news.kind) {
    case LawFaultKind::chattering:
    case LawFaultKind::oscillating:
      words << ": joint " << robot_.joints[evidence.tremor.joint].name << ", ";
      words.number(evidence.tremor.frequency_hz, 0) << " Hz, swings of ";
      words.number(evidence.tremor.size, 2) << ", allowed ";
      words.number(evidence.tremor.least_size, 2) << (news.kind == LawFaultKind::chattering ? " N m" : " rad/s");
      break;
    case LawFaultKind::tracking_lost:
      words << ": joint " << robot_.joints[evidence.joint].name << ", error ";
      words.number(evidence.value, 3) << " rad, allowed ";
      words.number(evidence.allowed, 3);
      break;
    case LawFaultKind::guard_busy:
      words << ": joint " << robot_.joints[evidence.joint].name
            << (evidence.clamped == Probation::kSlewed ? " slewed in " : " clamped in ");
      words.number(100 * evidence.value, 1) << " % of ticks, allowed ";
      words.number(100 * evidence.allowed, 0) << ": ";
      tell_clamped(evidence, words);
      break;
    case LawFaultKind::guard_stopped:
      words << ": joint " << robot_.joints[evidence.joint].name << ", "
            << wire::to_string(guard_.joint_fault(evidence.joint));
      tell_beyond(robot_, in_, evidence.joint, guard_.joint_fault(evidence.joint), words);
      break;
    case LawFaultKind::overran:
      (words << ": a step took ").number(1e6 * evidence.value, 1) << " us, allowed ";
      (words.number(1e6 * evidence.allowed, 1) << ", ").number(Probation::kMostLong, 0) << " times in a row";
      break;
    default:
      break;
  }
  return words;
}

}  // namespace lithe::step
