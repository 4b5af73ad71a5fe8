// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: overran
// Searches a large grid in every step.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    double best = 1e9;
    for (int i = 0; i < 400'000; ++i) best = std::min(best, std::fabs(std::sin(i * 1e-3) - t.position_rad[0]));
    u.torque_nm[0] = 0.01 * best;
  }
};
LITHE_LAW(Hostile, "takes_ten_milliseconds");
