// SPDX-License-Identifier: Apache-2.0
// From what a child left behind to a sentence for an agent.
#pragma once

#include <cstdint>
#include <string>

#include "trial/core/report.hpp"
#include "trial/sandbox/sandbox.hpp"

namespace lithe::trial {

struct Verdict {
  bool ok = false;
  bool starved = false;         // the board gave the trial no time: nothing is known about the law
  bool unable = false;          // the sandbox does not work here: likewise
  bool out_of_time = false;     // it did not come to an end, or so it seems
  std::string reason;           // empty when ok
  std::uint64_t pc_offset = 0;  // of a crash: bytes from the law's start, if it lies behind that; 0 = unknown
  Report report;
};

Verdict judge(const Outcome& outcome, const Limits& limits);

}  // namespace lithe::trial
