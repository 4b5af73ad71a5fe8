// SPDX-License-Identifier: Apache-2.0
// `lithe doctor`: the checklist for one core, its tier, and both as text and as JSON. Reads only.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "host/doctor/item.hpp"
#include "host/read/machine.hpp"

namespace lithe::host {

enum class Tier : std::uint8_t {
  a,  // isolated since the boot, without a tick
  b,  // isolated at run time
  c,  // the Spine is pinned and other tasks are kept away by their affinity
  d,  // unprotected
};
char letter(Tier tier);

// A gate that the core does not pass.
struct Missing {
  Tier tier = Tier::d;  // the tier that needs it
  int number = 0;       // of the item; 0: a gate of the measurement
  std::string id;
  std::string words;
};

struct TierVerdict {
  Tier tier = Tier::d;
  std::vector<Missing> missing;  // for the next better tier; empty at tier A
};

// `findings`: of the whole checklist, in its order. A gate needs `ok` or `not_applicable`; `unknown` does not pass it.
// A measurement has gates of its own.
TierVerdict judge_tier(const Subject& subject, std::span<const Finding> findings);

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
