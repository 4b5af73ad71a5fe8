// SPDX-License-Identifier: Apache-2.0
// The supervisor's connection to the compile service (lawd).
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "supervisor/link/services/service_link.hpp"

namespace lithe::control {

struct LawText {
  std::string name;
  std::string source;
  std::uint32_t budget_ns = 0;  // time limit of a step; 0 = not checked
};

// Contract: one thread · never blocks after start() · every compile is answered once, also when lawd dies.
class LawdLink {
 public:
  using Callback = ServiceLink::Callback;
  static constexpr std::int64_t kCompileTimeoutNs = 60'000'000'000;  // from when lawd receives the request
  static constexpr std::size_t kMaxChecks = 8;
  static constexpr std::int64_t kRestartPauseNs = ServiceLink::kRestartPauseNs;

  // `program`: path of lawd. `cpus`: cores that lawd and its compilers may use. `joints`: number of joints in the dry
  // run.
  LawdLink(std::string program, std::vector<int> cpus, std::size_t joints);

  // File descriptor of the code arena for lawd and its successors; call before start(). -1 = no arena.
  void give_arena(int fd) { service_.give(fd); }
  // Switches admission and dry run off: for tests of the containment in the Spine.
  void open_gates() { gates_ = false; }

  Result<> start(std::int64_t now_ns) { return service_.start(now_ns); }
  // The answer is lawd's own on success; a Refusal carries the diagnostics in `detail`.
  void compile(const LawText& law, Callback callback, std::int64_t now_ns);
  // The same for `law check`: every compile() goes first, and at most kMaxChecks wait.
  void check(const LawText& law, Callback callback, std::int64_t now_ns);
  // Links a compiled law for a slot of the arena and writes it there. `hash`: from the answer to compile().
  void place(const std::string& hash, std::uint32_t slot, Callback callback, std::int64_t now_ns);
  // Answers {"line", "function"} for an offset [bytes] from the start of the law's slot, or of its object.
  void locate(const std::string& hash, std::uint64_t offset, bool placed, Callback callback, std::int64_t now_ns);
  // Reads answers; restarts the service when it has died. Call after poll() and at least ten times a second.
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
