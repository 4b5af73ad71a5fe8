// SPDX-License-Identifier: Apache-2.0
// What a signal handler is told.
#pragma once

#include <ucontext.h>

#include <cstdint>

namespace lithe {

// The instruction at which a signal came: of the third argument of its handler (SA_SIGINFO).
inline std::uint64_t program_counter(const void* context) noexcept {
  const auto& machine = static_cast<const ucontext_t*>(context)->uc_mcontext;
#if defined(__x86_64__)
  return static_cast<std::uint64_t>(machine.gregs[REG_RIP]);
#else
  return machine.pc;
#endif
}

}  // namespace lithe
