// SPDX-License-Identifier: Apache-2.0
// Sandbox: a child process that can only compute, with limits on time and memory.
#pragma once

#include <sys/types.h>

#include <cstddef>
#include <functional>

#include "spine/core/host/child.hpp"
#include "spine/core/result.hpp"

namespace lithe::trial {

// A sanitizer needs address space and system calls that a trial does not allow.
#if defined(__has_feature)
#define LITHE_TRIAL_HAS(feature) __has_feature(feature)
#else
#define LITHE_TRIAL_HAS(feature) 0
#endif
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__) || LITHE_TRIAL_HAS(address_sanitizer) || \
    LITHE_TRIAL_HAS(thread_sanitizer) || LITHE_TRIAL_HAS(realtime_sanitizer)
inline constexpr bool kSanitized = true;
#else
inline constexpr bool kSanitized = false;
#endif
#undef LITHE_TRIAL_HAS

struct Limits {
  int cpu_ms = 150;                                   // then the child reports where it is, and exits
  int wall_ms = 600;                                  // then it is killed, also if it got little processor time
  std::size_t memory_bytes = std::size_t{512} << 20;  // in addition to the parent's
};

using Outcome = ChildEnd;

// run_forked(): before it is killed at wall_ms, the child may report where it is. At most `expected` bytes of output.
Outcome run_sandboxed(const std::function<int(int pipe_fd)>& body, const Limits& limits, std::size_t expected);

// In the child, in this order, each for good:
// Resource limits, no descriptor but the pipe, no core file, no other process.
Result<> shed_rights(int pipe_fd, const Limits& limits);
// From now on allowed: read files, map memory, write to the pipe, exit. Needed to load a law with dlopen, which runs
// code of it.
Result<> allow_loading_only(int pipe_fd);
// Reserves this much memory for malloc, which from now on returns none to the kernel.
bool keep_heap(std::size_t bytes);
// From now on allowed: write to the pipe, read the clock, exit. A law needs none of them.
Result<> allow_computing_only(int pipe_fd);

// A gate for system calls, without a seccomp filter: when a filter is freed, the kernel interrupts every core, the
// Spine's as well (once per trial, measured on Linux 6.18).
inline constexpr int kSyscallUserDispatch = 59;  // PR_SET_SYSCALL_USER_DISPATCH, which older headers lack

// A system call; returns the kernel's result, a negative error number on failure. Works also when the gate is shut, if
// the filter allows its number.
// Contract: also in a signal handler
long ask_kernel(long number, long first = 0, long second = 0, long third = 0) noexcept;

// From now on and for good, a system call from any other instruction raises SIGSYS (Linux' syscall user dispatch,
// without a switch). A law that jumps to this instruction on purpose is still limited by allow_trials_only(). x86 only.
// Contract: in the child; its signal handlers must end it, because they cannot return any more
Result<> block_system_calls();

// In the parent, once, before the first child: from now on it and its children can fork, set limits, read files, write
// to open descriptors, map memory and send signals. No network, no other program, no writing of files.
Result<> allow_trials_only();

}  // namespace lithe::trial
