// SPDX-License-Identifier: Apache-2.0
// Runs a function in a child process, with a time limit. Its output comes through a pipe.
#pragma once

#include <cstddef>
#include <functional>
#include <string>
#include <vector>

namespace lithe {

struct ChildLimits {
  int wall_ms;               // the child is killed after this time
  std::size_t output_bytes;  // further output is read and dropped
  bool whole_group = false;  // the child may start programs: they are killed with it, and their processor time counts
  bool last_words = false;   // before it is killed it gets SIGPROF, and 500 ms to write what it has
};

struct ChildEnd {
  bool started = false;    // there was a child; otherwise `output` says why not
  bool timed_out = false;  // killed at wall_ms
  int signal = 0;          // the signal that ended it, 0 = none
  int exit_code = -1;      // meaningful when signal == 0
  std::string output;
  bool cut = false;  // it wrote more than output_bytes
  double cpu_ms = 0, wall_ms = 0;
};

// Forks; the child runs `body` with the writing end of the pipe and exits with its return value. It is killed when this
// process dies. With whole_group this process adopts the child's orphans (PR_SET_CHILD_SUBREAPER).
// Contract: one child at a time
ChildEnd run_forked(const std::function<int(int out_fd)>& body, const ChildLimits& limits);

// Replaces this process by a program, found as a shell finds it. Returns only when that fails: the errno.
int exec_program(const std::vector<std::string>& argv);

}  // namespace lithe
