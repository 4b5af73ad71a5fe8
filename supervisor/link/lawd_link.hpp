// SPDX-License-Identifier: Apache-2.0
// The compile service as the supervisor sees it.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "supervisor/link/service_link.hpp"

namespace lithe::control {

struct LawText {
  std::string name;
  std::string source;
  std::uint32_t budget_ns = 0;  // that a step may take; 0 = nobody asks
};

// Contract: one thread · never blocks after start() · every compile is answered once, also when lawd dies.
class LawdLink {
 public:
  using Callback = ServiceLink::Callback;
  static constexpr std::int64_t kCompileTimeoutNs = 60'000'000'000;  // from the moment that lawd has it
  static constexpr std::size_t kMaxChecks = 8;
  static constexpr std::int64_t kRestartPauseNs = ServiceLink::kRestartPauseNs;

  // `program`: path of lawd; `cpus`: cores it and its compilers may use; `joints`: of the robot its laws are tried for.
  LawdLink(std::string program, std::vector<int> cpus, std::size_t joints);

  // The code arena, for lawd and those that follow it; before start(). -1: none.
  void give_arena(int fd) { service_.give(fd); }
  // From now on nothing is admitted or run dry: for tests of what the Spine must withstand by itself.
  void open_gates() { gates_ = false; }

  Result<> start(std::int64_t now_ns) { return service_.start(now_ns); }
  // The answer is lawd's own on success; a Refusal carries the diagnostics in `detail`.
  void compile(const LawText& law, Callback callback, std::int64_t now_ns);
  // The same for a law that is only tried: every compile() goes before it, and kMaxChecks at most wait.
  void check(const LawText& law, Callback callback, std::int64_t now_ns);
  // Has a compiled law linked for a slot of the arena and written there; `hash`: as the answer to compile() gave it.
  void place(const std::string& hash, std::uint32_t slot, Callback callback, std::int64_t now_ns);
  // {"line", "function"} of a place in a compiled law, so many bytes from the start of its slot, or of its object.
  void locate(const std::string& hash, std::uint64_t offset, bool placed, Callback callback, std::int64_t now_ns);
  // Reads answers, notices a death, starts it again. Call after poll() and at least ten times a second.
  void serve(std::int64_t now_ns) { service_.serve(now_ns); }
  void stop() { service_.stop(); }

  int poll_fd() const { return service_.poll_fd(); }  // -1 while it is down
  pid_t pid() const { return service_.pid(); }
  unsigned restarts() const { return service_.restarts(); }

 private:
  swap::Json compile_request(const LawText& law) const;

  std::size_t joints_;
  bool gates_ = true;
  ServiceLink service_;
};

}  // namespace lithe::control
