// SPDX-License-Identifier: Apache-2.0
#include "trial/sandbox/sandbox.hpp"

#include <sys/prctl.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <cstring>

#if defined(__x86_64__)
// One function with a known address range, from which the kernel allows calls.
asm(R"(
  .text
  .type lithe_trial_gate, @function
lithe_trial_gate:
  movq %rdi, %rax
  movq %rsi, %rdi
  movq %rdx, %rsi
  movq %rcx, %rdx
  syscall
  ret
lithe_trial_gate_end:
  .size lithe_trial_gate, . - lithe_trial_gate
)");
extern "C" {
[[gnu::visibility("hidden")]] long lithe_trial_gate(long number, long first, long second, long third);
[[gnu::visibility("hidden")]] void lithe_trial_gate_end();  // its address only
}
#endif

namespace lithe::trial {

#if defined(__x86_64__)

long ask_kernel(long number, long first, long second, long third) noexcept {
  return lithe_trial_gate(number, first, second, third);
}

Result<> block_system_calls() {
  constexpr unsigned long kOn = 1;
  const auto from = reinterpret_cast<std::uintptr_t>(&lithe_trial_gate);
  const std::uintptr_t bytes = reinterpret_cast<std::uintptr_t>(&lithe_trial_gate_end) - from;
  if (prctl(kSyscallUserDispatch, kOn, from, bytes, nullptr) == 0) return done();
  return Error{std::string("syscall user dispatch was refused: ") + std::strerror(errno)};
}

#else

long ask_kernel(long number, long first, long second, long third) noexcept {
  const long got = syscall(number, first, second, third);
  return got < 0 ? -errno : got;
}

Result<> block_system_calls() { return Error{"syscall user dispatch exists on x86 only"}; }

#endif

}  // namespace lithe::trial
