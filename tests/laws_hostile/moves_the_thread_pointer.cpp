// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: not_contained
// gate: words
// Sets the register by which a thread finds its own variables: whatever runs after the law reads from address 0.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
#if defined(__x86_64__)
    if (t.t_s > 0.2) asm volatile("mov %0, %%fs" : : "r"(0));
#else
    if (t.t_s > 0.2) asm volatile("msr tpidr_el0, %0" : : "r"(0ull));
#endif
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    }
  }
};
LITHE_LAW(Hostile, "moves_the_thread_pointer");
