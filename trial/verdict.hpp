// SPDX-License-Identifier: Apache-2.0
// Makes the verdict and its sentence from a child's report.
#pragma once

#include <cstdint>
#include <string>

#include "trial/core/report.hpp"
#include "trial/sandbox/sandbox.hpp"

namespace lithe::trial {

struct Verdict {
  bool ok = false;
  bool starved = false;      // the trial got too little processor time: no evidence against the law
  bool unable = false;       // the sandbox does not work on this machine: likewise
  bool out_of_time = false;  // it did not finish in time
  std::string reason;        // empty when ok
  std::uint64_t pc_offset =
      0;  // of a crash, or of the operation that gave no number: offset from the law's start [bytes]; 0 = unknown
  Report report;
};

Verdict verdict_of(const Outcome& outcome, const Limits& limits);

}  // namespace lithe::trial
