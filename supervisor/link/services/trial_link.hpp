// SPDX-License-Identifier: Apache-2.0
// The supervisor's connection to the trial (lithe-trial).
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "supervisor/link/services/lawd_link.hpp"
#include "supervisor/link/services/service_link.hpp"

namespace lithe::control {

// A trial request.
struct TrialRequest {
  std::string object;  // shared object
  Placed placed;       // slot 0: the shared object is tried
  std::uint32_t budget_ns = 0;
  int box_ms = 150;
  std::string recording;  // name of the robot whose last telemetry is replayed
  Json params = Json::object();
};

// Contract: as ServiceLink
class TrialLink : public ServiceLink {
 public:
  static constexpr int kMostStarved = 5;  // attempts without processor time before the law is refused

  // `program`: path of lithe-trial; `robot_file`: absolute.
  TrialLink(std::string program, std::string robot_file, std::vector<int> cpus);

  // Logs a warning when the trial cannot map the given arena.
  Result<> start(std::int64_t now_ns);
  // Answers {"safe_law_text"}: what was wrong when the safe law stopped the simulated robot; "" = nothing.
  // `limit_ns`: for the answer, its simulated runs included.
  void ask_safe_law(Callback callback, std::int64_t limit_ns, std::int64_t now_ns);
  // On success: the trial's report. Refusal: trial_failed (the report in `detail.trial`, with "pc_offset" of a crash),
  // trial_starved, trial_died, or trial_unavailable (the sandbox does not work on this machine). With Turn::idle every
  // other trial goes before it, and one without processor time is not repeated.
  void attempt(const TrialRequest& trial, Callback callback, std::int64_t now_ns, Turn turn = Turn::in_line,
               int starved = 0);
};

}  // namespace lithe::control
