// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Fast on ordinary numbers, a hundred times slower on denormal ones.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    volatile double x = t.position_rad[0];
    for (int i = 0; i < 20'000; ++i) x = x * 0.999999;
    u.torque_nm[0] = 1e-3 * x;
  }
};
LITHE_LAW(Hostile, "slow_on_denormals");
