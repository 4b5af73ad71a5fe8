// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Writes at an index that is computed from NaN when a sample is bad.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    }
    u.torque_nm[static_cast<std::size_t>(static_cast<long>(t.position_rad[0] * 0) / 4096)] += 0.01;
  }
};
LITHE_LAW(Hostile, "index_from_nan");
