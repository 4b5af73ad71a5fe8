// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: harmless
// gate: words
// Reads the cycle counter: the same input gives another output each time.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
#if defined(__x86_64__)
    u.torque_nm[0] = double(__builtin_ia32_rdtsc() % 1000) * 1e-4;
#else
    std::uint64_t now;
    asm volatile("mrs %0, cntvct_el0" : "=r"(now));  // no function of the compiler reads it
    u.torque_nm[0] = double(now % 1000) * 1e-4;
#endif
  }
};
LITHE_LAW(Hostile, "reads_the_clock");
