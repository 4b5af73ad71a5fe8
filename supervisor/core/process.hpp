// SPDX-License-Identifier: Apache-2.0
// Starts, watches and ends the child processes of the supervisor.
#pragma once

#include <sys/types.h>

#include <optional>
#include <string>
#include <vector>

#include "spine/core/host/fd.hpp"
#include "spine/core/result.hpp"

namespace lithe::control {

struct Launch {
  std::vector<std::string> argv;  // argv[0] is the path of the program
  int stdin_fd = -1;              // -1: /dev/null
  int stdout_fd = -1;
  int stderr_fd = -1;        // -1: inherited
  int extra_fd = -1;         // becomes descriptor 3 of the program
  bool own_session = false;  // outlives this process and does not get the terminal's Ctrl-C
  bool dies_with_parent = false;
  bool idle_priority = false;  // SCHED_IDLE and nice 19: runs only when the core is otherwise idle
  std::vector<int> cpus;       // empty: inherited
};

// A process handle (pidfd): a reused pid is never signalled.
// Contract: one thread · not a child (an adopted Spine) works too, but has no exit status.
class Process {
 public:
  static Result<Process> start(const Launch& launch);
  static Result<Process> adopt(pid_t pid);

  pid_t pid() const { return pid_; }
  int poll_fd() const { return pidfd_.get(); }  // readable once the process has ended
  bool ended();
  bool wait(int timeout_ms);  // true when it ended in time
  void signal(int number) const;
  // How it ended: "exit code 3", "killed by signal 9 (Killed)". Empty while it runs.
  const std::string& verdict() const { return verdict_; }
  std::optional<int> exit_code() const { return exit_code_; }

 private:
  Process(pid_t pid, Fd pidfd, bool child) : pid_(pid), pidfd_(std::move(pidfd)), child_(child) {}

  pid_t pid_;
  Fd pidfd_;
  bool child_;
  bool ended_ = false;
  std::string verdict_;
  std::optional<int> exit_code_;
};

// Processor time of a process and of all processes in its session, and whether any of them is ready to run (state R or
// D). A sleeping process is not; none is while the session leader is stopped.
struct Work {
  double cpu_s = 0;
  bool wants_to_run = false;
};
Work work_of_session(pid_t leader);

// The cores of the supervisor and the compilers: `allowed` without the Spine's and the Transport's; never empty unless
// `allowed` is.
std::vector<int> cores_beside(const std::vector<int>& allowed, int spine_cpu, int transport_cpu);

// Its command line, printable, 100 characters at most; empty when it has ended, or is in another container.
std::string command_of(pid_t pid);

// State of a process as in proc(5): R, S, D, T ...; '?' when it cannot be read.
char state_of(pid_t pid);
inline bool is_stopped(char state) { return state == 'T' || state == 't'; }

// Restricts a process (0: this one) to these cores; without effect when the list is empty.
Result<> set_affinity(pid_t pid, const std::vector<int>& cpus);

}  // namespace lithe::control
