// SPDX-License-Identifier: Apache-2.0
#include "host/doctor/tier.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <optional>

namespace lithe::host {
namespace {

struct Gate {
  Tier tier;
  const char* id;
};

constexpr Gate kGates[] = {
    {Tier::c, "user_tasks"},    {Tier::c, "spine_pinned"}, {Tier::c, "rt_throttling"},    {Tier::c, "fair_server"},
    {Tier::b, "irq_affinity"},  {Tier::b, "memory_lock"},  {Tier::b, "domain_isolation"}, {Tier::a, "tickless"},
    {Tier::a, "rcu_callbacks"}, {Tier::a, "governor"},
};
constexpr double kFewSwitchesPerS = 2;

bool passes(State state) { return state == State::ok || state == State::not_applicable; }

void ask_items(Tier tier, std::span<const Finding> findings, std::vector<Missing>& missing) {
  const std::span<const Item> items = checklist();
  for (const Gate& gate : kGates) {
    if (gate.tier != tier) continue;
    const auto item =
        std::find_if(items.begin(), items.end(), [&](const Item& each) { return each.id == std::string(gate.id); });
    const Finding& finding = findings[static_cast<std::size_t>(item - items.begin())];
    if (!passes(finding.state)) missing.push_back({tier, item->number, gate.id, finding.words});
  }
}

void ask_measurement(Tier tier, const Subject& subject, std::vector<Missing>& missing) {
  if (!subject.measured) return;
  const double switches = subject.measured->switches_per_s;
  if ((tier == Tier::b && switches > kFewSwitchesPerS) || (tier == Tier::a && switches > 0)) {
    missing.push_back(
        {tier, 0, "measured_switches", fmt::format("other tasks took the core {:.1f} times a second", switches)});
  }
  const std::optional<double> stolen_s = subject.measured->stolen_s;
  if (tier == Tier::a && stolen_s != 0.0) {
    missing.push_back(
        {tier, 0, "measured_steal",
         stolen_s ? fmt::format("the hypervisor took {:.2f} s", *stolen_s) : "stolen time cannot be read"});
  }
}

std::vector<Missing> missing_for(Tier tier, const Subject& subject, std::span<const Finding> findings) {
  std::vector<Missing> missing;
  ask_items(tier, findings, missing);
  if (tier == Tier::a && subject.isolated.how(subject.cpu) != Isolation::boot)
    missing.push_back({tier, 1, "boot_isolation", "the core is not isolated since the boot"});
  ask_measurement(tier, subject, missing);
  return missing;
}

}  // namespace

char letter(Tier tier) { return "ABCD"[static_cast<std::size_t>(tier)]; }

TierVerdict judge_tier(const Subject& subject, std::span<const Finding> findings) {
  TierVerdict verdict;
  for (const Tier next : {Tier::c, Tier::b, Tier::a}) {
    verdict.missing = missing_for(next, subject, findings);
    if (!verdict.missing.empty()) return verdict;
    verdict.tier = next;
  }
  return verdict;
}

}  // namespace lithe::host
