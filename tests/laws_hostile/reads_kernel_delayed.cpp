// SPDX-License-Identifier: Apache-2.0
// stopped-by: containment
// without-gates: bad_access
// Works for twenty seconds, then reads an address of the kernel.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {
    std::uint32_t steps = 0;
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    if (++s.steps < 20'000) {
      for (std::uint32_t j = 0; j < t.joints; ++j) {
        u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
      }
      return;
    }
    u.torque_nm[0] = double(*(volatile long*)0xffff'8000'0000'0000);
  }
};
LITHE_LAW(Hostile, "reads_kernel_delayed");
