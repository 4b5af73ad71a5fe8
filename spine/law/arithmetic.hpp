// SPDX-License-Identifier: Apache-2.0
// How the processor computes while a law runs.
#pragma once

#include <cstdint>

#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

#include "spine/core/rt.hpp"

namespace lithe::law {

// The processor's control word for floating-point numbers.
#if defined(__x86_64__)
inline constexpr std::uint64_t kFlushDenormals = 1u << 15 | 1u << 6;  // MXCSR: results, operands
inline std::uint64_t arithmetic_control() LITHE_RT { return _mm_getcsr(); }
inline void set_arithmetic_control(std::uint64_t word) LITHE_RT { _mm_setcsr(static_cast<std::uint32_t>(word)); }
#else
inline constexpr std::uint64_t kFlushDenormals = 1u << 24;  // FPCR.FZ: both
inline std::uint64_t arithmetic_control() LITHE_RT {
  std::uint64_t word = 0;
  asm volatile("mrs %0, fpcr" : "=r"(word));
  return word;
}
inline void set_arithmetic_control(std::uint64_t word) LITHE_RT { asm volatile("msr fpcr, %0" : : "r"(word)); }
#endif

// Denormal numbers count as 0 from here on. The control word before.
inline std::uint64_t flush_denormals() LITHE_RT {
  const std::uint64_t before = arithmetic_control();
  set_arithmetic_control(before | kFlushDenormals);
  return before;
}

// Calls a law's code, step or init. Every program does it in this way, so that a law computes the same everywhere.
// Denormal numbers (below 2.2e-308) count as 0 meanwhile: on many processors they are up to 100 times slower, so a
// filter that decays at rest would become slower and slower. The caller's own arithmetic is as before afterwards; when
// the law ends by a fault, the FaultBarrier restores it.
// Contract: RT · the call itself is bounded by its caller
template <class Call>
LITHE_LEFT_BY_A_JUMP void with_law_arithmetic(const Call& call) LITHE_RT {
  const std::uint64_t before = flush_denormals();
  call();
  set_arithmetic_control(before);
}

}  // namespace lithe::law
