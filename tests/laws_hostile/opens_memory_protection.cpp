// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: harmless
// gate: words
// Takes down the protection keys, then writes as it likes.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
#if defined(__x86_64__)
    unsigned a = 0, c = 0, d = 0;
    if (t.tick == ~0ull) asm volatile("wrpkru" : : "a"(a), "c"(c), "d"(d));
#else
    if (t.tick == ~0ull) asm volatile("msr fpcr, %0" : : "r"(0ull));
#endif
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    }
  }
};
LITHE_LAW(Hostile, "opens_memory_protection");
