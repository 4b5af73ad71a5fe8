// SPDX-License-Identifier: Apache-2.0
// The tick's work with laws: runs the active law, replaces one that fails, runs a shadow, commits the next.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "spine/core/serialise.hpp"
#include "spine/loop/spine.hpp"

namespace lithe::loop {

using contain::Trouble;
using wire::EventKind;
using wire::LawFaultKind;
namespace flag = wire::telemetry_flag;

namespace {

LITHE_LEFT_BY_A_JUMP void call_law(void* sandbox) LITHE_RT { static_cast<law::Sandbox*>(sandbox)->call(); }

// x - x is 0 for every finite x and NaN for all others. Outputs for stopped joints are ignored.
bool output_is_finite(const Effort& effort, std::uint32_t joints, const guard::Guard& guard) LITHE_RT {
  double sum = 0;
  bool bounded = true;
  for (std::uint32_t j = 0; j < joints; ++j) {
    if (guard.stopped(j)) continue;
    sum += (effort.torque_nm[j] - effort.torque_nm[j]) + (effort.velocity_rad_s[j] - effort.velocity_rad_s[j]) +
           (effort.kp_nm_rad[j] - effort.kp_nm_rad[j]) + (effort.kd_nm_s_rad[j] - effort.kd_nm_s_rad[j]);
    bounded = bounded && !std::isinf(effort.position_rad[j]);  // NaN = no position target
  }
  return bounded && sum == 0;
}

bool input_is_finite(const Tick& in) LITHE_RT {
  double sum = 0;
  for (std::uint32_t j = 0; j < in.joints; ++j) {
    sum += (in.position_rad[j] - in.position_rad[j]) + (in.velocity_rad_s[j] - in.velocity_rad_s[j]) +
           (in.torque_nm[j] - in.torque_nm[j]);
  }
  return sum == 0;
}

void copy_effort(const Effort& from, Effort& to, std::uint32_t joints) LITHE_RT {
  const std::size_t bytes = joints * sizeof(double);
  std::memcpy(to.torque_nm.data(), from.torque_nm.data(), bytes);
  std::memcpy(to.position_rad.data(), from.position_rad.data(), bytes);
  std::memcpy(to.velocity_rad_s.data(), from.velocity_rad_s.data(), bytes);
  std::memcpy(to.kp_nm_rad.data(), from.kp_nm_rad.data(), bytes);
  std::memcpy(to.kd_nm_s_rad.data(), from.kd_nm_s_rad.data(), bytes);
}

std::uint32_t clamp_ns(std::int64_t duration_ns) LITHE_RT {
  return static_cast<std::uint32_t>(std::clamp<std::int64_t>(duration_ns, 0, UINT32_MAX));
}

bool is_runaway(wire::Fault fault) LITHE_RT {
  return fault == wire::Fault::position_limit || fault == wire::Fault::velocity_limit;
}

}  // namespace

// Runs the active law. If it fails, it is replaced in this same tick by the law before it, else by the safe law.
void Spine::step_law(std::int64_t now_ns) LITHE_RT {
  probes_.fill(0.0);
  if (slot_.active() == nullptr || !mode_.law_runs()) {
    bumpless_.start(0);  // the rest of a blend belongs to the old motion
    return effort_.clear(joints_);
  }
  const Trouble trouble = run_law(*slot_.active(), effort_);
  if (trouble && !fall_back(trouble, now_ns)) return effort_.clear(joints_);
  std::copy(sandbox_.probes.begin(), sandbox_.probes.end(), probes_.begin());
  if (bumpless_.fading()) flags_ |= flag::kBlending;
  bumpless_.apply(in_, guard_.expected_torque_nm(), effort_);
}

// Runs `law` on copies of its inputs. Its state and output are kept only if it did not fail.
Trouble Spine::run_law(law::Resident& law, Effort& effort) LITHE_RT {
  if (law.since_ns == 0) law.since_ns = in_.t_ns;
  in_.t_s = static_cast<double>(in_.t_ns - law.since_ns) * 1e-9;
  sandbox_.enter(law, in_);
  law_from_ns_ = clock_.now_ns();
  Trouble trouble{};
  if (cell_ != nullptr) {
    const std::int64_t budget_ns = law.terms.budget_ns > 0 ? law.terms.budget_ns : budget_ns_;
    trouble = cell_->run(law_from_ns_ + std::min(budget_ns, period_ns_), &call_law, &sandbox_);
  } else {
    sandbox_.call();
  }
  if (trouble) return trouble;
  const bool sound_input = input_is_finite(in_);
  // A non-finite output that comes from a broken sensor is not a law fault: the guard handles it. The state of this
  // step is not kept.
  if (sound_input && !output_is_finite(sandbox_.effort, joints_, guard_)) return {LawFaultKind::not_finite, 0, 0};
  if (sound_input) sandbox_.keep_state(law);
  copy_effort(sandbox_.effort, effort, joints_);
  return trouble;
}

// Runs the law before the failed one in this same tick. False: there is none, or it fails too; then the safe law takes
// over.
bool Spine::fall_back(const Trouble& first, std::int64_t now_ns) LITHE_RT {
  wire::LawFault fault = fault_of(first, now_ns);
  const std::int64_t from_ns = law_from_ns_;
  if (!resume_previous()) {
    report(fault, 0, clock_.now_ns() - from_ns);
    stop_for_law(first.kind, now_ns);
    return false;
  }
  const Trouble second = run_law(*slot_.active(), effort_);
  report(fault, slot_.active()->law_id, clock_.now_ns() - from_ns);
  tell_rollback(first.kind, now_ns);
  if (!second) return true;
  // At most two laws per tick: a third would cost a third time budget.
  fault = fault_of(second, now_ns);
  report(fault, 0, clock_.now_ns() - law_from_ns_);
  if (resume_previous()) tell_rollback(second.kind, now_ns);  // the law that runs after a reset
  stop_for_law(second.kind, now_ns);
  return false;
}

// Rollback without a law fault: from the next tick on the law before the active one runs again.
void Spine::replace_law(LawFaultKind why, std::int64_t now_ns) LITHE_RT {
  wire::LawFault fault = fault_of({why, 0, 0}, now_ns);
  const bool resumed = resume_previous();
  report(fault, resumed ? slot_.active()->law_id : 0, 0);
  resumed ? tell_rollback(why, now_ns) : stop_for_law(why, now_ns);
  why_ = {};
}

// Goes back by one step: to the previous parameters while the last ones are on probation, else to the law before the
// active one, whose own state is used. False: there is no such law.
bool Spine::resume_previous() LITHE_RT {
  params_went_ = probation_.of_params();
  if (params_went_) {
    probation_.end_params();
    slot_.active()->restore_trusted_params();
    out_.params(*slot_.active());
    return true;
  }
  probation_.end();
  if (slot_.before(1) == nullptr) return false;
  law::FieldBits mended = 0;
  slot_.rollback(law::Carry::none, 1, &mended);
  flags_ |= flag::kRolledBack;
  greet_law(0);
  out_.params(*slot_.active());
  tell_not_carried(*slot_.active(), mended, in_.t_ns);
  return true;
}

// The State fields that start from their defaults, because the old value was not usable.
void Spine::tell_not_carried(const law::Resident& law, law::FieldBits fields, std::int64_t now_ns) LITHE_RT {
  if (fields == 0) return;
  Words words;
  std::uint32_t count = 0;
  for (std::uint32_t i = 0; i < law.descriptor->state_count && i < kMaxStateFields; ++i) {
    if ((fields >> i & 1) == 0) continue;
    const auto& name = law.descriptor->state[i].name;
    const auto length = static_cast<std::size_t>(std::find(std::begin(name), std::end(name), '\0') - std::begin(name));
    words << (count++ == 0 ? "" : ", ") << std::string_view(name, length);
  }
  words << ": no finite number; starts from its default";
  out_.event(EventKind::state_not_carried, now_ns, law.law_id, law.request_id, count, words.text());
}

// While a group is stopped, the law's values for it are not checked. Before the law drives that group again, non-finite
// State fields are set to their defaults.
void Spine::mend_law(std::int64_t now_ns) LITHE_RT {
  law::Resident& law = *slot_.active();
  tell_not_carried(law, law::mend_state(*law.descriptor, law.state.data()), now_ns);
}

void Spine::tell_rollback(LawFaultKind why, std::int64_t now_ns) LITHE_RT {
  if (params_went_) {
    out_.event(EventKind::params_reverted, now_ns, slot_.active()->law_id, params_request_id_, 0, in_words(why).text());
    return;
  }
  out_.event(EventKind::law_rolled_back, now_ns, slot_.active()->law_id, slot_.active()->request_id, 1,
             in_words(why).text());
}

// "oscillating: joint wrist, 31 Hz".
Words Spine::in_words(LawFaultKind why) const LITHE_RT {
  Words words;
  words << wire::to_string(why) << (why_.text().empty() ? "" : ": ") << why_.text();
  return words;
}

void Spine::stop_for_law(LawFaultKind kind, std::int64_t now_ns) LITHE_RT {
  const wire::Fault fault = kind == LawFaultKind::not_finite ? wire::Fault::law_not_finite : wire::Fault::law_faulted;
  if (kind == LawFaultKind::not_finite) flags_ |= flag::kNotFinite;
  if (mode_.fail(fault)) {
    out_.event(EventKind::safe_stop, now_ns, static_cast<std::uint32_t>(fault), 0, 0, wire::to_string(fault));
  }
}

// Copied from the active law: the Loader may unload it as soon as another one is active.
wire::LawFault Spine::fault_of(const Trouble& trouble, std::int64_t now_ns) const LITHE_RT {
  const law::Resident& law = *slot_.active();
  wire::LawFault fault{};
  fault.tick = tick_;
  fault.t_ns = now_ns;
  fault.request_id = law.request_id;
  fault.kind = static_cast<std::uint32_t>(trouble.kind);
  fault.law_id = law.law_id;
  fault.pc = trouble.pc;
  fault.address = trouble.address;
  fault.slot = law.slot;
  const std::uint64_t offset = trouble.pc - law.code_address;
  fault.pc_offset = law.code_address != 0 && offset < law.code_bytes ? static_cast<std::uint32_t>(offset) : 0;
  return fault;
}

void Spine::report(wire::LawFault& fault, std::uint32_t to_law_id, std::int64_t took_ns) LITHE_RT {
  fault.to_law_id = to_law_id;
  fault.took_ns = clamp_ns(took_ns);
  out_.law_fault(fault);
  flags_ |= flag::kLawFaulted;
  out_.event(EventKind::law_faulted, fault.t_ns, fault.kind, fault.request_id,
             static_cast<double>(fault.took_ns) * 1e-3, in_words(static_cast<LawFaultKind>(fault.kind)).text());
}

// Probation: a law that does worse than the one before it is replaced; from the next tick on the earlier law runs
// again.
void Spine::judge_law(const guard::Verdict& verdict, std::int64_t now_ns) LITHE_RT {
  out_.record().law_id = slot_.active() == nullptr ? 0 : slot_.active()->law_id;  // the law that ran in this tick
  if (slot_.active() == nullptr) return;
  // The guard has just stopped joints because of this law: it must not be the law that runs after the reset.
  const auto ran_away = [](const guard::Group& group) { return group.news && is_runaway(group.fault); };
  if (probation_.on() && !verdict.recovering && std::ranges::any_of(guard_.groups(), ran_away)) {
    return replace_law(LawFaultKind::guard_stopped, now_ns);
  }
  if (!mode_.law_runs()) return;
  if (probation_.on()) flags_ |= flag::kOnProbation;
  if (probation_.of_params()) flags_ |= flag::kParamsOnProbation;
  for (std::uint32_t j = 0; j < joints_; ++j) wanted_nm_[j] = wanted_nm(effort_, in_, j);
  const Probation::News news = probation_.watch({in_, wanted_nm_, durations_.law_ns, verdict.law_flags});
  if (probation_.unproven()) flags_ |= flag::kUnproven;
  tell_probation(news, now_ns);
  if (news.kind == LawFaultKind::none) return;
  name_evidence(news);
  replace_law(news.kind, now_ns);
}

void Spine::tell_probation(const Probation::News& news, std::int64_t now_ns) LITHE_RT {
  const law::Resident& law = *slot_.active();
  constexpr std::string_view kAtRest = "the robot moved too little to judge by; its probation goes on";
  if (news.law_unproven) out_.event(EventKind::law_unproven, now_ns, law.law_id, law.request_id, 0, kAtRest);
  if (news.params_unproven) out_.event(EventKind::law_unproven, now_ns, law.law_id, params_request_id_, 1, kAtRest);
  if (news.params_confirmed) {
    out_.event(EventKind::params_confirmed, now_ns, law.law_id, params_request_id_, 0, "their probation is over");
  }
  if (!news.law_confirmed) return;
  out_.event(
      EventKind::law_confirmed, now_ns, law.law_id, law.request_id, 0,
      guard_.any_stopped() ? "its probation is over, with a part of the robot stopped" : "its probation is over");
}

// "joint wrist, 31 Hz"; "joint elbow, error 0.312 rad, allowed 0.150".
void Spine::name_evidence(const Probation::News& news) LITHE_RT {
  const Probation::Evidence& evidence = news.evidence;
  const bool trembles = news.kind == LawFaultKind::chattering || news.kind == LawFaultKind::oscillating;
  why_ = {};
  switch (news.kind) {
    case LawFaultKind::chattering:
    case LawFaultKind::oscillating:
    case LawFaultKind::tracking_lost:
      why_ << "joint " << robot_.joints[trembles ? evidence.tremor.joint : evidence.joint].name << ", ";
      if (trembles) {
        why_.number(evidence.tremor.frequency_hz, 0) << " Hz";
      } else {
        (why_ << "error ").number(evidence.value, 3) << " rad, allowed ";
        why_.number(evidence.allowed, 3);
      }
      break;
    case LawFaultKind::guard_busy:
      (why_ << "it clamped ").number(100 * evidence.value, 0) << " % of the last ticks, allowed ";
      why_.number(100 * evidence.allowed, 0);
      break;
    case LawFaultKind::overran:
      (why_ << "a step took ").number(1e6 * evidence.value, 1) << " us, allowed ";
      why_.number(1e6 * evidence.allowed, 1);
      break;
    default:
      break;
  }
}

// Commit, one atomic exchange: the staged law runs from the next tick on.
void Spine::swap(std::int64_t now_ns) LITHE_RT {
  if (shadow_.law() != nullptr) return step_shadow(now_ns);
  law::Resident* candidate = slot_.take();
  if (candidate == nullptr) return;
  if (candidate->terms.shadow_ticks > 0) return start_shadow(*candidate, now_ns);
  commit(*candidate, law::Carry::named, now_ns);
}

void Spine::commit(law::Resident& candidate, law::Carry carry, std::int64_t now_ns) LITHE_RT {
  const law::Commit done = slot_.commit(candidate, carry);
  const bool follows = done.previous_id != 0;
  greet_law(follows ? candidate.terms.blend_ticks : 0);
  probation_.end();
  if (follows) probation_.start(candidate.terms);
  flags_ |= flag::kSwapCommitted;
  out_.event(EventKind::law_committed, now_ns, done.law_id, done.request_id, static_cast<double>(done.fields_carried),
             "runs from the next tick");
  tell_not_carried(candidate, done.not_carried, now_ns);
  out_.params(candidate);
}

void Spine::start_shadow(law::Resident& candidate, std::int64_t now_ns) LITHE_RT {
  serialise_core();
  law::Commit carried;
  slot_.carry_into(candidate, carried);
  shadow_.start(candidate, tick_, joints_);
  out_.event(EventKind::shadow_started, now_ns, candidate.law_id, candidate.request_id, candidate.terms.shadow_ticks,
             "runs beside the active law");
  tell_not_carried(candidate, carried.not_carried, now_ns);
}

// Runs the shadow candidate, after the active law's output has been handed over.
void Spine::step_shadow(std::int64_t now_ns) LITHE_RT {
  if (!mode_.law_runs() || (flags_ & (flag::kRolledBack | flag::kLawFaulted)) != 0) {
    return end_shadow(false, "the active law was replaced", now_ns);
  }
  if (guard_.any_stopped()) {
    return end_shadow(false, "a part of the robot is stopped: nothing can be compared there", now_ns);
  }
  flags_ |= flag::kShadowing;
  const std::int64_t from_ns = clock_.now_ns();
  const Trouble trouble = run_law(*shadow_.law(), shadow_effort_);
  if (trouble) {
    shadow_.fail();
    return end_shadow(false, wire::to_string(trouble.kind), now_ns);
  }
  const std::int64_t took_ns = clock_.now_ns() - from_ns;
  switch (shadow_.compare(in_, effort_, shadow_effort_, took_ns)) {
    case Shadow::Opinion::go_on:
      return out_.shadow(shadow_.report());
    case Shadow::Opinion::refuse:
      return end_shadow(false, "it disagrees with the active law by more than the tolerance", now_ns);
    case Shadow::Opinion::promote:
      return end_shadow(true, "it agrees with the active law", now_ns);
  }
}

void Spine::end_shadow(bool promoted, std::string_view why, std::int64_t now_ns) LITHE_RT {
  law::Resident& candidate = *shadow_.law();
  out_.shadow(shadow_.report());
  out_.event(EventKind::shadow_ended, now_ns, promoted ? 1 : 0, candidate.request_id, shadow_.largest_difference_nm(),
             why);
  shadow_.end();
  if (promoted) return commit(candidate, law::Carry::none, now_ns);  // its state is warm: it ran in the shadow
  slot_.refuse(candidate);
}

// Its slot may have held another law's code.
void Spine::greet_law(std::uint32_t blend_ticks) LITHE_RT {
  serialise_core();
  bumpless_.start(blend_ticks);
}

}  // namespace lithe::loop
