// SPDX-License-Identifier: Apache-2.0
// `lithe doctor`: the checklist for one core, its tier, and both as text and as JSON. Reads only.
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "host/doctor/item.hpp"
#include "host/doctor/tier.hpp"
#include "host/read/machine.hpp"

namespace lithe::host {

struct Diagnosis {
  Subject subject;
  KernelFacts kernel;
  Hypervisor hypervisor;
  std::vector<Finding> findings;  // of the checklist, in its order
  TierVerdict verdict;

  bool is_isolated() const { return verdict.tier == Tier::a || verdict.tier == Tier::b; }
};

Diagnosis diagnose(const HostFiles& files, int cpu, std::optional<Measured> measured = std::nullopt);

// The tier first, then what is wrong, then what is unknown, then counts; with `all`, every item.
std::string to_text(const Diagnosis& diagnosis, bool all);

// docs/host.md has the fields.
nlohmann::json to_json(const Diagnosis& diagnosis);

}  // namespace lithe::host
