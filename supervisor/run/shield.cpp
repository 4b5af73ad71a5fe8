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

namespace {

std::vector<int> cores_of(const wire::RobotInfo& spine) {
  std::vector<int> cores = {static_cast<int>(spine.cpu_spine)};
  const auto transport = static_cast<int>(spine.cpu_transport);
  const bool own = transport != cores[0] && transport != static_cast<int>(spine.cpu_housekeeping) &&
                   transport != static_cast<int>(spine.cpu_brain);
  if (own && spine.transport_inline == 0) cores.push_back(transport);
  std::sort(cores.begin(), cores.end());
  return spine.cpu_spine == spine.cpu_housekeeping ? std::vector<int>{} : cores;
}

}  // namespace

void Supervisor::raise_shield() {
  if (!options_.shield) return;
  if (live_spine(config_.name)) {  // it has its cores already, whatever the file and our affinity say
    if (const auto spine = SpineLink::attach(config_.name)) shield_cpus_ = cores_of(spine->info());
  }
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
