// SPDX-License-Identifier: Apache-2.0
// How well a core is protected: one of four tiers, each with gates that must all be passed.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "host/doctor/item.hpp"

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

}  // namespace lithe::host
