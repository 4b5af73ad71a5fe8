// SPDX-License-Identifier: Apache-2.0
// The only way out of a child whose system calls are shut, without a filter of its own: the kernel frees a filter with
// an interrupt to every core (1.0 per trial, measured on Linux 6.18), and the Spine's is one of them.
#pragma once

#include "spine/core/result.hpp"

namespace lithe::trial {

constexpr int kSyscallUserDispatch = 59;  // PR_SET_SYSCALL_USER_DISPATCH, which older headers lack

// A system call, as the kernel answers it: a negative error number when it fails. Allowed wherever its number is, also
// behind a shut gate. Contract: also in a signal handler
long ask_kernel(long number, long first = 0, long second = 0, long third = 0) noexcept;

// From now on and for good, a system call from any other instruction raises SIGSYS (Linux' syscall user dispatch,
// without a switch). A law that jumps to this one on purpose still meets allow_trials_only(). x86 only.
// Contract: in the child; its handlers end it, for they cannot return any more
Result<> shut_all_but_the_gate();

}  // namespace lithe::trial
