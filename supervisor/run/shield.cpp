// SPDX-License-Identifier: Apache-2.0
// `lithe run --shield`: raised before the first child starts, lowered when the robot has ended.

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include "spine/core/host/cores.hpp"
#include "spine/core/time.hpp"
#include "spine/robot/cores/cpu_plan.hpp"
#include "supervisor/run/supervisor.hpp"

namespace lithe::control {

namespace {

constexpr std::int64_t kShieldNs = 10 * kNsPerS;  // between two looks for kernel threads that started

// Of a Spine that ticks already.
robot::CpuPlan plan_of(const wire::RobotInfo& spine) {
  return {.housekeeping = static_cast<int>(spine.cpu_housekeeping),
          .spine = static_cast<int>(spine.cpu_spine),
          .brain = static_cast<int>(spine.cpu_brain),
          .transport = static_cast<int>(spine.cpu_transport),
          .transport_inline = spine.transport_inline != 0};
}

}  // namespace

void Supervisor::raise_shield() {
  if (!options_.shield) return;
  if (live_spine(config_.name)) {  // it has its cores already, whatever the file and our affinity say
    if (const auto spine = SpineLink::attach(config_.name)) shield_cpus_ = robot::own_cores(plan_of(spine->info()));
  }
  if (shield_cpus_.empty()) {
    throw Halt{
        1, "no shield: the Spine has no core of its own here; it needs a machine (or a cpuset) of two cores or more"};
  }
  auto shield = host::Shield::raise({.cores = shield_cpus_, .leave = {::getpid()}});
  if (!shield) throw Halt{1, fmt::format("no shield, so the robot was not started: {}", shield.message())};
  shield_.emplace(std::move(*shield));
  shield_told_ = shield_json(*shield_);
  spdlog::info("shield: {}", host::shield_words(shield_->facts()));
  for (const std::string& note : shield_->facts().notes) spdlog::warn("shield: {}", note);
}

void Supervisor::lower_shield() {
  if (!shield_) return;
  if (const auto lowered = shield_->lower(); !lowered) {
    spdlog::error("{}", lowered.message());
  } else {
    spdlog::info("shield: lowered");
    if (const std::string born = host::born_words(*lowered); !born.empty()) spdlog::info("shield: {}", born);
  }
  shield_.reset();
}

void Supervisor::keep_shield_up(std::int64_t now_ns) {
  if (!shield_ || now_ns - shield_kept_ns_ < kShieldNs) return;
  shield_kept_ns_ = now_ns;
  const auto kept = shield_->keep_up();
  if (!kept) spdlog::warn("shield: {}", kept.message());
  if (kept && !kept->empty()) spdlog::warn("shield: {}", *kept);
  shield_told_ = shield_json(*shield_);
}

Json shield_json(const host::Shield& shield) {
  const host::ShieldFacts& facts = shield.facts();
  return {{"mechanism", host::word_of(facts.mechanism)},
          {"cores", cpu_list(facts.cores)},
          {"tasks_moved", facts.moved},
          {"tasks_refused", facts.refused},
          {"settings", facts.settings},
          {"words", host::shield_words(facts)},
          {"notes", facts.notes}};
}

}  // namespace lithe::control
