// SPDX-License-Identifier: Apache-2.0
// stopped-by: compile
// without-gates: uncompilable
// A parameter that starts outside its own range.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {
    lithe::Param kp{9, 0, 4};
  };
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    }
  }
};
LITHE_LAW(Hostile, "param_outside_its_range");
