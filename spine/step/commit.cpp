// SPDX-License-Identifier: Apache-2.0
// What becomes the active law, and with which parameters: commands, commits, shadow runs.
#include <algorithm>

#include "spine/core/serialise.hpp"
#include "spine/step/laws.hpp"

namespace lithe::step {

using wire::CommandResult;
using wire::EventKind;
namespace flag = wire::telemetry_flag;

CommandResult Laws::set_params(const wire::Command& command) LITHE_RT {
  law::Resident* law = slot_.active();
  if (law == nullptr || (command.law_id != 0 && command.law_id != law->law_id)) return CommandResult::refused_law;
  if (command.count == 0 || command.count > wire::kNparam) return CommandResult::refused_range;
  for (std::uint32_t i = 0; i < command.count; ++i) {
    const std::uint32_t index = command.index[i];
    if (index >= law->descriptor->param_count || index >= kMaxParams) return CommandResult::refused_range;
    const Param& param = law->params[index];
    if (!(param.min <= command.value[i] && command.value[i] <= param.max)) return CommandResult::refused_range;
  }
  if (!probation_.of_params()) law->trust_params();
  law->remember_params();
  for (std::uint32_t i = 0; i < command.count; ++i) law->set_param(command.index[i], command.value[i]);
  return params_set(command, command.count, "");
}

CommandResult Laws::revert_params(const wire::Command& command) LITHE_RT {
  law::Resident* law = slot_.active();
  if (law == nullptr || (command.law_id != 0 && command.law_id != law->law_id)) return CommandResult::refused_law;
  if (!probation_.of_params()) law->trust_params();
  law->revert_params();
  return params_set(command, law->descriptor->param_count, "as before the last change");
}

// New values are on probation; the previous ones are kept.
CommandResult Laws::params_set(const wire::Command& command, std::uint32_t count, std::string_view text) LITHE_RT {
  report_.params_changed = true;
  report_.event(EventKind::params_applied, slot_.active()->law_id, command.request_id, count, text);
  probation_.start_params(command.request_id);
  return CommandResult::done;
}

CommandResult Laws::roll_back(const wire::Command& command) LITHE_RT {
  const std::uint32_t steps = std::max(1u, command.count);
  if (slot_.before(steps) == nullptr) return CommandResult::refused_law;
  if (command.law_id != 0 && command.law_id != slot_.active()->law_id) return CommandResult::refused_law;
  const std::uint32_t blend_ticks = slot_.active()->terms.blend_ticks;
  law::FieldBits mended = 0;
  slot_.rollback(law::Carry::named, steps, &mended);
  report_.flags |= flag::kRolledBack;
  probation_.end();
  begin_law(blend_ticks);
  tell_not_carried(*slot_.active(), mended);
  report_.event(EventKind::law_rolled_back, slot_.active()->law_id, command.request_id, steps,
                "an earlier law runs again");
  report_.params_changed = true;
  return CommandResult::done;
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
  const law::Commit done = slot_.commit(candidate, carry);
  const bool follows = done.previous_id != 0;
  begin_law(follows ? candidate.terms.blend_ticks : 0);
  probation_.end();
  if (follows) probation_.start(candidate.terms);
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
  if (!mode_.law_runs() || (report_.flags & (flag::kRolledBack | flag::kLawFaulted)) != 0)
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

}  // namespace lithe::step
