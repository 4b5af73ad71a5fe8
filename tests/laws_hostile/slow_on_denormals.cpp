// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Fast on ordinary numbers, a hundred times slower on denormal ones: on every processor what some processors do.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    volatile double x = t.position_rad[0];
    const bool denormal = x != 0 && x < 2.2e-308 && x > -2.2e-308;
    const int rounds = denormal ? 2'000'000 : 20'000;
    for (int i = 0; i < rounds; ++i) x = x * 0.999999;
    u.torque_nm[0] = 1e-3 * x;
  }
};
LITHE_LAW(Hostile, "slow_on_denormals");
