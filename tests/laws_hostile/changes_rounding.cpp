// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: harmless
// gate: words
// Makes all floating point round towards zero, for everybody.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
#if defined(__x86_64__)
    unsigned control = 0x7f80;
    __builtin_ia32_ldmxcsr(control);
#else
    __builtin_aarch64_set_fpcr(0xc00000);
#endif
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    }
  }
};
LITHE_LAW(Hostile, "changes_rounding");
