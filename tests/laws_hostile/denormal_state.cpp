// SPDX-License-Identifier: Apache-2.0
// stopped-by: none
// without-gates: harmless
// A bank of filters that has decayed into denormal numbers. They count as 0 while a law runs; else many a processor
// would take about a hundred times longer than on ordinary ones, which is above the budget.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {
    std::array<double, 200> z = [] {
      std::array<double, 200> small{};
      small.fill(1e-310);
      return small;
    }();
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    double sum = 0;
    for (int k = 0; k < 60; ++k) {
      for (double& z : s.z) sum += z = 0.995 * z;
    }
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j] + sum;
    }
  }
};
LITHE_LAW(Hostile, "denormal_state");
