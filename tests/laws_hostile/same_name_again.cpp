// SPDX-License-Identifier: Apache-2.0
// stopped-by: none
// without-gates: harmless
// Called like the law that may be running before it, with other State: nothing wrong with that.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {
    double integral_rad_s = 0;
    float filtered_rad_s = 0;
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    }
    s.integral_rad_s += t.dt_s;
  }
};
LITHE_LAW(Hostile, "same_name_again");
