// SPDX-License-Identifier: Apache-2.0
// Runs work in a child process with limits on time, memory and file size.
#pragma once

#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "spine/core/host/child.hpp"

namespace lithe::lawd {

// Multiplies the time limits of all later children: for a processor that is slow. Call before the first one.
void set_time_factor(double factor);
double time_factor();

struct Limits {
  int wall_ms = 20'000;
  int cpu_s = 20;
  std::size_t memory_bytes = std::size_t{3} << 30;
  std::size_t file_bytes = std::size_t{256} << 20;
};

// Its output is at most 4 MiB.
struct Outcome : ChildEnd {
  // Stopped by wall_ms before it got half of its allowed processor time: no evidence about its input.
  bool starved = false;

  bool clean() const { return !timed_out && signal == 0 && exit_code == 0; }
};

// run_forked() with these limits: stdin, stdout and stderr of the child are /dev/null; what it starts ends with it.
Outcome run_child(const std::function<int(int out_fd)>& body, const Limits& limits);

// Runs a program with its stderr (or another of its streams) captured in Outcome::output.
Outcome run_program(const std::vector<std::string>& argv, const Limits& limits, int stream = 2);

// "the machine is too busy: the compiler got 310 ms of the processor in 20000 ms".
std::string starved_text(const std::string& who, const Outcome& outcome);

// The demangled name; the symbol itself when it is not a C++ name.
std::string readable(std::string_view symbol);

// "SIGSEGV (invalid memory access)".
std::string signal_text(int signal);

}  // namespace lithe::lawd
