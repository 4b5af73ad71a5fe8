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

Laws::Laws(const Wiring& wiring)
    : robot_(wiring.robot),
      slot_(wiring.slot),
      sandbox_(wiring.sandbox),
      guard_(wiring.guard),
      mode_(wiring.mode),
      in_(wiring.in),
      planned_(wiring.planned),
      report_(wiring.report),
      period_ns_(std::llround(1e9 / wiring.robot.rate_hz)),
      budget_ns_(std::llround(static_cast<double>(period_ns_) * wiring.robot.swap.budget_share)) {
  probation_.configure(wiring.robot);
  watch_.configure(wiring.robot);
  constexpr double kPowerMemoryS = 0.1;
  forget_power_ = std::exp(-1.0 / (kPowerMemoryS * wiring.robot.rate_hz));
}

void Laws::step(Host& host, std::array<double, kMaxProbes>& probes) LITHE_RT {
  probes.fill(0.0);
  holds_here_ = false;
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
  if (back == Back::nowhere) return stop(why);
  report(fault, slot_.active()->law_id, 0, words.text());
  tell_back(back, words.text());
}

// Neither: no law runs from the next tick on.
void Laws::stop(const Probation::News& why) LITHE_RT {
  const EventText words = in_words(why);
  wire::LawFault fault = fault_of({why.kind, 0, 0});
  report(fault, 0, 0, words.text());
  stop_for(why.kind, words.text());
  if (why.kind != LawFaultKind::guard_stopped || drove_out(why.evidence.joint)) mark(words.text());
}

// Goes back by one step: to the previous parameters while the last ones are on probation, else to the law before the
// active one, whose own state is used, if there is one.
Laws::Back Laws::step_back() LITHE_RT {
  if (probation_.of_params()) {
    probation_.end_params(in_);
    watch_.forget();
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
  if (!mode_.law_runs()) {
    watch_.rest();
    return probation_.rest(in_.joints, mode_.fault() != wire::Fault::none);
  }
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
    if (asked_into_soft_stop(j, torque_nm[j])) clamped[j] &= ~flag::kPositionClamped;   // of the plan
    if (std::abs(planned_.stepped_rad[j]) > Probation::kLeastErrorRad) clamped[j] = 0;  // likewise
  }
  const Probation::Observed observed{in_,     effort_,       torque_nm, report_.law_ns,
                                     clamped, joint_stopped, held_back, planned_};
  const Probation::News news = probation_.watch(observed);
  if (probation_.unproven()) report_.flags |= flag::kUnproven;
  tell_probation(news);
  if (news.kind != LawFaultKind::none) return replace(news);
  obey(watch_.see(*slot_.active(), observed, probation_));
  if (watch_.suspects()) report_.flags |= flag::kLawSuspected;
}

// The law before it, if the robot file wants that, finds joints far from their setpoint: it must not chase it.
void Laws::obey(const Watch::News& news) LITHE_RT {
  if (news.found.kind == LawFaultKind::none) return;
  const law::Resident& law = *slot_.active();
  if (!news.is_laws_fault) {
    EventText words = in_words(news.found);
    if (news.found.kind == LawFaultKind::tracking_lost)
      (words << ": wants ").number(news.toward_nm, 2) << " N m towards it";
    report_.event(EventKind::law_suspected, static_cast<std::uint32_t>(news.found.kind), law.request_id, law.law_id,
                  words.text());
    return;
  }
  if (robot_.swap.watch == robot::WatchAction::last_good) {
    holds_here_ = news.any_far;
    return replace(news.found);
  }
  if (robot_.swap.watch == robot::WatchAction::stop) stop(news.found);
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

}  // namespace lithe::step
