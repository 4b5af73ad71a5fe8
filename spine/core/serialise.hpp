// SPDX-License-Identifier: Apache-2.0
// Synchronises a core's instruction fetch before it runs code that another core has written.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"

namespace lithe {

// Forgets every instruction this core has fetched or decoded ahead. Needed once between seeing that new code is in
// place (an acquire load) and running it, when other code may have been at that address before: Intel SDM 3A §9.1.3
// (cross-modifying code), Arm ARM B2.2.5 (context synchronisation). It concerns the calling core alone.
// Contract: RT · no system call · about 100 ns
inline void serialise_core() LITHE_RT {
#if defined(__x86_64__)
  // iretq to the next line: cpuid would leave a virtual machine for microseconds, `serialize` is too new. It pops what
  // the lines before it push, below the red zone that the compiler may be using.
  std::uint64_t word = 0, stack = 0;
  asm volatile(
      "movq %%rsp, %1\n\t"
      "leaq -128(%%rsp), %%rsp\n\t"
      "movl %%ss, %k0\n\t"
      "pushq %0\n\t"
      "pushq %1\n\t"
      "pushfq\n\t"
      "movl %%cs, %k0\n\t"
      "pushq %0\n\t"
      "leaq 1f(%%rip), %0\n\t"
      "pushq %0\n\t"
      "iretq\n"
      "1:"
      : "=&r"(word), "=&r"(stack)
      :
      : "memory", "cc");
#elif defined(__aarch64__)
  asm volatile("isb" ::: "memory");
#else
#error "say how this kind of machine synchronises its instruction fetch"
#endif
}

}  // namespace lithe
