// SPDX-License-Identifier: Apache-2.0
// From what a child left behind to a sentence for an agent.
#pragma once

#include <string>

#include "trial/report.hpp"
#include "trial/sandbox.hpp"

namespace lithe::trial {

struct Verdict {
  bool ok = false;
  bool starved = false;  // the board gave the trial no time: nothing is known about the law
  bool unable = false;   // the sandbox does not work here: likewise
  std::string reason;    // empty when ok
  std::string where;     // "pd.cpp:12" when the place of a crash could be found
  Report report;
};

// `object`: with debug information, for the line of a crash; may be empty. `pc_is_absolute`: it was linked for the
// address it ran at.
Verdict judge(const Outcome& outcome, const Limits& limits, const std::string& object, bool pc_is_absolute);

}  // namespace lithe::trial
