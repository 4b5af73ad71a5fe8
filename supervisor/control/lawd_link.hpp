// SPDX-License-Identifier: Apache-2.0
// The compile service as the supervisor sees it: a child that may crash, and is then started again.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "spine/core/result.hpp"
#include "supervisor/control/fd.hpp"
#include "supervisor/control/lines.hpp"
#include "supervisor/control/process.hpp"
#include "supervisor/swap/answer.hpp"

namespace lithe::control {

// Hands over one law at a time, so that a law that takes too long, or kills the service, costs only itself.
// Contract: one thread · never blocks after start() · every compile is answered once, also when lawd dies.
class LawdLink {
 public:
  using Callback = std::function<void(const swap::Answer&)>;
  static constexpr std::int64_t kCompileTimeoutNs = 60'000'000'000;  // from the moment that lawd has it
  static constexpr std::size_t kMaxChecks = 8;
  static constexpr std::int64_t kRestartPauseNs = 500'000'000;

  // `program`: path of lawd; `cpus`: cores it and its compilers may use; `joints`: of the robot its laws are tried for.
  LawdLink(std::string program, std::vector<int> cpus, std::size_t joints)
      : program_(std::move(program)), cpus_(std::move(cpus)), joints_(joints) {}
  ~LawdLink() { stop(); }

  // The code arena, for lawd and those that follow it; before start(). -1: none.
  void give_arena(int fd) { arena_fd_ = fd; }

  Result<> start(std::int64_t now_ns);
  // The answer is lawd's own on success; a Refusal carries the diagnostics in `detail`.
  void compile(const std::string& name, const std::string& source, Callback callback, std::int64_t now_ns);
  // The same for a law that is only tried: every compile() goes before it, and kMaxChecks at most wait.
  void check(const std::string& name, const std::string& source, Callback callback, std::int64_t now_ns);
  // Has a compiled law linked for a slot of the arena and written there; `hash`: as the answer to compile() gave it.
  void place(const std::string& hash, std::uint32_t slot, Callback callback, std::int64_t now_ns);
  // Reads answers, notices a death, starts it again. Call after poll() and at least ten times a second.
  void serve(std::int64_t now_ns);
  void stop();

  int poll_fd() const { return socket_.get(); }  // -1 while it is down
  pid_t pid() const { return process_ ? process_->pid() : 0; }
  unsigned restarts() const { return restarts_; }

 private:
  struct Job {
    std::uint64_t id;
    std::string request;
    Callback callback;
  };
  struct Active {
    std::uint64_t id;
    Callback callback;
    std::int64_t deadline_ns;
  };

  Job job(const std::string& name, const std::string& source, Callback callback);
  void read_answers();
  void write_requests(std::int64_t now_ns);
  void take(const std::string& line);
  void buried(std::string why, std::int64_t now_ns);  // by value: it may be the dead process's own verdict
  void refuse_waiting(const std::string& why);

  std::string program_;
  std::vector<int> cpus_;
  std::size_t joints_;
  int arena_fd_ = -1;
  std::optional<Process> process_;
  Fd socket_;
  LineBuffer in_{std::size_t{64} << 20};
  std::string out_;
  std::deque<Job> swaps_;
  std::deque<Job> checks_;
  std::optional<Active> active_;  // what lawd has in its hands
  std::uint64_t next_id_ = 1;
  std::int64_t restart_at_ns_ = 0;
  unsigned restarts_ = 0;
};

}  // namespace lithe::control
