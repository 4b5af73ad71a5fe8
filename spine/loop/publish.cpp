// SPDX-License-Identifier: Apache-2.0
#include "spine/loop/publish.hpp"

#include <algorithm>
#include <cstddef>
#include <cstring>

namespace lithe::loop {

using step::clamp_ns;

Publisher::Publisher(ipc::SpineMemory& memory, std::uint32_t joints)
    : header_(&memory.header),
      telemetry_(memory.telemetry),
      events_(memory.events_tick),
      params_(memory.params),
      law_faults_(memory.law_faults),
      plan_decisions_(memory.plan_decisions),
      shadow_(memory.shadow),
      law_state_(memory.law_state),
      release_jitter_(memory.release_jitter),
      handoff_(memory.handoff),
      law_(memory.law),
      guard_(memory.guard),
      tick_(memory.tick),
      bus_(memory.bus),
      used_(wire::active_ranges<wire::Telemetry>(joints)) {
  record_.joint_count = joints;
}

void Publisher::skipped(std::uint32_t count, std::int64_t release_jitter_ns, std::int64_t period_ns) LITHE_RT {
  record_.missed_releases += count;
  constexpr std::uint32_t kMostCounted = 1000;  // per stall: bounds the work, and is enough for the quantiles
  for (std::uint32_t i = 1; i <= std::min(count, kMostCounted); ++i)
    release_jitter_.add(release_jitter_ns + i * period_ns);
}

void Publisher::publish(const Durations& durations, bool fresh_sample) LITHE_RT {
  record_.release_jitter_ns = clamp_ns(durations.release_jitter_ns);
  record_.handoff_ns = clamp_ns(durations.handoff_ns);
  record_.law_ns = clamp_ns(durations.law_ns);
  record_.guard_ns = clamp_ns(durations.guard_ns);
  record_.tick_ns = clamp_ns(durations.tick_ns);
  record_.bus_ns = clamp_ns(durations.bus_ns);
  telemetry_.push(record_, used_);
  release_jitter_.add(durations.release_jitter_ns);
  handoff_.add(durations.handoff_ns);
  law_.add(durations.law_ns);
  guard_.add(durations.guard_ns);
  tick_.add(durations.tick_ns);
  if (fresh_sample) bus_.add(durations.bus_ns);
}

void Publisher::event(wire::EventKind kind, std::int64_t now_ns, std::uint32_t code, double value,
                      std::string_view text) LITHE_RT {
  events_.push(step::make_event(kind, record_.tick, now_ns, code, 0, value, text));
}

void Publisher::tell(const step::Report& report, const step::Laws& laws) LITHE_RT {
  for (const wire::Event& event : report.events()) events_.push(event);
  for (const wire::LawFault& fault : report.law_faults()) law_faults_.push(fault);
  if (report.plan_decided) plan_decisions_.push(report.plan_decision);
  if (report.params_changed && laws.active() != nullptr) params(*laws.active());
  if (report.shadow_changed) shadow_.write(laws.shadow());
}

void Publisher::params(const law::Resident& law) LITHE_RT {
  param_values_.law_id = law.law_id;
  param_values_.count = std::min<std::uint32_t>(law.descriptor->param_count, wire::kNparam);
  param_values_.tick = record_.tick;
  for (std::uint32_t i = 0; i < param_values_.count; ++i) param_values_.value[i] = law.params[i].value;
  params_.write(param_values_);
}

void Publisher::state(const law::Resident& law) LITHE_RT {
  const std::size_t bytes = std::min<std::size_t>(law.descriptor->state_size, kMaxStateBytes);
  state_.law_id = law.law_id;
  state_.state_bytes = static_cast<std::uint32_t>(bytes);
  state_.tick = record_.tick;
  std::memcpy(state_.bytes.data(), law.state.data(), bytes);
  wire::WordRanges used;
  used.add(0, offsetof(wire::LawState, bytes) + bytes);
  law_state_.write(state_, used);
}

void Publisher::heartbeat(std::int64_t now_ns) LITHE_RT {
  std::atomic_ref<std::int64_t>(header_->heartbeat_ns).store(now_ns, std::memory_order_release);
}

}  // namespace lithe::loop
