// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: not_finite
// Starts from a mean over no samples.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {
    double mean_rad = 0;
  };

  static void init(const lithe::History& past, const Params&, State& s) {
    double sum = 0;
    for (const auto& tick : past) sum += tick.position_rad[0] * 0;
    s.mean_rad = sum / sum;
  }

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = s.mean_rad - t.position_rad[0];
  }
};
LITHE_LAW(Hostile, "nan_from_init");
