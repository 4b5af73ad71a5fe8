// SPDX-License-Identifier: Apache-2.0
// `lithe run --shield`: raised before the first child starts, lowered when the robot has ended.
#include "supervisor/run/shield.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <algorithm>

#include "spine/core/host/cores.hpp"
#include "supervisor/run/supervisor.hpp"

namespace lithe::control {

std::vector<int> cores_to_shield(const robot::CpuPlan& plan) {
  if (plan.spine_shares) return {};
  std::vector<int> cores = {plan.spine};
  const bool own = !plan.transport_inline && plan.transport != plan.housekeeping && plan.transport != plan.brain;
  if (own && plan.transport != plan.spine) cores.push_back(plan.transport);
  std::sort(cores.begin(), cores.end());
  return cores;
}

void Supervisor::raise_shield() {
  if (!options_.shield) return;
  if (shield_cpus_.empty()) {
    throw Halt{
        1, "no shield: the Spine has no core of its own here; it needs a machine (or a cpuset) of two cores or more"};
  }
  auto shield = host::Shield::raise({.cores = shield_cpus_, .leave = {::getpid()}});
  if (!shield) throw Halt{1, fmt::format("no shield, so the robot was not started: {}", shield.message())};
  shield_.emplace(std::move(*shield));
  spdlog::info("shield: {}", host::shield_words(shield_->facts()));
  for (const std::string& note : shield_->facts().notes) spdlog::warn("shield: {}", note);
}

void Supervisor::lower_shield() {
  if (!shield_) return;
  if (const auto lowered = shield_->lower(); !lowered) {
    spdlog::error("{}", lowered.message());
  } else {
    spdlog::info("shield: lowered");
  }
  shield_.reset();
}

Json shield_json(const host::Shield* shield) {
  if (shield == nullptr) return nullptr;
  const host::ShieldFacts& facts = shield->facts();
  return {{"mechanism", host::word_of(facts.mechanism)},
          {"cores", cpu_list(facts.cores)},
          {"tasks_moved", facts.moved},
          {"tasks_refused", facts.refused},
          {"settings", facts.settings},
          {"words", host::shield_words(facts)},
          {"notes", facts.notes}};
}

}  // namespace lithe::control
