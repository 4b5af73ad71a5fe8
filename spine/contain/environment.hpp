// SPDX-License-Identifier: Apache-2.0
// Processor state that a call can change for its caller: rounding, denormals, traps, direction, alignment.
#pragma once

#include <cstdint>

#if defined(__x86_64__)
#include <x86intrin.h>
#endif

#include "spine/core/rt.hpp"

namespace lithe::contain {

// The state to restore after each call. Read once on its own thread. `restore` takes a few nanoseconds, and writes a
// register only when a law has changed it.
// Contract: RT · one thread
class Environment {
 public:
#if defined(__x86_64__)
  static Environment now() LITHE_RT {
    Environment environment;
    environment.mxcsr_ = _mm_getcsr();
    environment.x87_ = x87_control();
    return environment;
  }

  void restore() const LITHE_RT {
    const std::uint64_t flags = __builtin_ia32_readeflags_u64();
    if (((_mm_getcsr() ^ mxcsr_) & ~kSticky) != 0) _mm_setcsr(mxcsr_);
    if (x87_control() != x87_ || (x87_status() & kX87Top) != 0) asm volatile("fninit\n\tfldcw %0" : : "m"(x87_));
    if ((flags & kBadFlags) != 0) __builtin_ia32_writeeflags_u64(flags & ~kBadFlags);
  }

  // For the first line of a signal handler: the kernel clears the direction flag, but not this one.
  static void allow_unaligned() LITHE_RT {
    const std::uint64_t flags = __builtin_ia32_readeflags_u64();
    if ((flags & kBadFlags) != 0) __builtin_ia32_writeeflags_u64(flags & ~kBadFlags);
  }

 private:
  static std::uint16_t x87_control() LITHE_RT {
    std::uint16_t word = 0;
    asm volatile("fnstcw %0" : "=m"(word));
    return word;
  }
  static std::uint16_t x87_status() LITHE_RT {
    std::uint16_t word = 0;
    asm volatile("fnstsw %0" : "=a"(word));
    return word;
  }
  static constexpr std::uint32_t kSticky = 0x3f;    // sticky exception bits, not compared
  static constexpr std::uint16_t kX87Top = 0x3800;  // not 0: the law left values on the x87 stack
  // Direction flag; nested task flag, with which iretq faults (spine/core/serialise.hpp); trap on unaligned access.
  static constexpr std::uint64_t kBadFlags = 1u << 10 | 1u << 14 | 1u << 18;
  std::uint32_t mxcsr_ = 0;
  std::uint16_t x87_ = 0;
#else
  static Environment now() LITHE_RT {
    Environment environment;
    environment.fpcr_ = control();
    return environment;
  }

  void restore() const LITHE_RT {
    if (control() != fpcr_) asm volatile("msr fpcr, %0" : : "r"(fpcr_));
  }

  static void allow_unaligned() LITHE_RT {}

 private:
  static std::uint64_t control() LITHE_RT {
    std::uint64_t word = 0;
    asm volatile("mrs %0, fpcr" : "=r"(word));
    return word;
  }
  std::uint64_t fpcr_ = 0;
#endif
};

}  // namespace lithe::contain
