// SPDX-License-Identifier: Apache-2.0
// Blocks the system calls of a child without a seccomp filter. When a filter is freed, the kernel interrupts every
// core, the Spine's as well (once per trial, measured on Linux 6.18).
#pragma once

#include "spine/core/result.hpp"

namespace lithe::trial {

constexpr int kSyscallUserDispatch = 59;  // PR_SET_SYSCALL_USER_DISPATCH, which older headers lack

// A system call; returns the kernel's result, a negative error number on failure. Works also when the gate is shut, if
// the filter allows its number.
// Contract: also in a signal handler
long ask_kernel(long number, long first = 0, long second = 0, long third = 0) noexcept;

// From now on and for good, a system call from any other instruction raises SIGSYS (Linux' syscall user dispatch,
// without a switch). A law that jumps to this instruction on purpose is still limited by allow_trials_only(). x86 only.
// Contract: in the child; its signal handlers must end it, because they cannot return any more
Result<> shut_all_but_the_gate();

}  // namespace lithe::trial
