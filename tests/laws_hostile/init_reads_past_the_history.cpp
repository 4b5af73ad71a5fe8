// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: bad_access
// Reads a second of history that is not there.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {
    double x = 0;
  };

  static void init(const lithe::History& past, const Params&, State& s) {
    for (std::uint32_t i = 0; i < 1'000'000; ++i) s.x += past.ticks[i].position_rad[0];
  }

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    }
  }
};
LITHE_LAW(Hostile, "init_reads_past_the_history");
