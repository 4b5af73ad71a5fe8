// SPDX-License-Identifier: Apache-2.0
// The supervisor's connection to the trial (lithe-trial).
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "supervisor/link/services/service_link.hpp"

namespace lithe::control {

// A trial request.
struct TrialRequest {
  std::string object;      // shared object
  std::uint32_t slot = 0;  // of the arena; 0 = not placed: the shared object is tried
  std::uint32_t code_bytes = 0;
  std::uint64_t entry = 0;
  std::uint64_t image_hash = 0;
  std::uint32_t budget_ns = 0;
  int box_ms = 150;
  std::string recording;  // name of the robot whose last telemetry is replayed
  swap::Json params = swap::Json::object();
};

// Contract: one thread · never blocks after start() · every attempt() is answered once, also when the trial dies.
class TrialLink {
 public:
  using Callback = ServiceLink::Callback;
  static constexpr int kMostStarved = 5;  // attempts without processor time before the law is refused
  static constexpr std::int64_t kSafeLawNs = 60'000'000'000;  // for the answer, its runs included

  // `program`: path of lithe-trial; `robot_file`: absolute.
  TrialLink(std::string program, std::string robot_file, std::vector<int> cpus);

  void give_arena(int fd) {
    service_.give(fd);
    arena_ = fd >= 0;
  }
  // Logs a warning when the trial cannot map the given arena.
  Result<> start(std::int64_t now_ns);
  // What the trial found when the safe law stopped the simulated robot; "" = nothing wrong. No text: it does not
  // answer, and `why` says so.
  using SafeLawTold = std::function<void(const std::optional<std::string>& text, const std::string& why)>;
  void ask_safe_law(SafeLawTold told, std::int64_t now_ns);
  // On success: the trial's report. Refusal: trial_failed (the report in `detail.trial`, with "pc_offset" of a crash),
  // trial_starved, trial_died, or trial_unavailable (the sandbox does not work on this machine).
  void attempt(const TrialRequest& trial, Callback callback, std::int64_t now_ns);
  void serve(std::int64_t now_ns) { service_.serve(now_ns); }
  void stop() { service_.stop(); }

  int poll_fd() const { return service_.poll_fd(); }
  pid_t pid() const { return service_.pid(); }
  unsigned restarts() const { return service_.restarts(); }

 private:
  void ask(const TrialRequest& trial, int starved, Callback callback, std::int64_t now_ns);

  ServiceLink service_;
  bool arena_ = false;
};

}  // namespace lithe::control
