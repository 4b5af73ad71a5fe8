// SPDX-License-Identifier: Apache-2.0
// stopped-by: none
// without-gates: harmless
// Its helper is called like one of another law and does something else: each law has its own.
#include <lithe/law.hpp>

double helper(double x) { return 3 * x; }

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j)
      u.torque_nm[j] = helper(t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
  }
};
LITHE_LAW(Hostile, "same_symbols_again");
