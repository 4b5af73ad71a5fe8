// SPDX-License-Identifier: Apache-2.0
// stopped-by: none
// without-gates: harmless
// std::sort calls itself, but never deep.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    std::array<double, 32> a = t.position_rad;
    std::sort(a.begin(), a.begin() + t.joints);
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    }
    u.torque_nm[0] += 1e-9 * a[t.joints - 1];
  }
};
LITHE_LAW(Hostile, "sorts");
