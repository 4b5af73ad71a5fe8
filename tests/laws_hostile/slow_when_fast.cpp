// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Takes longer the faster the joint turns.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    volatile double x = 0;
    for (int i = 0; i < std::fabs(t.velocity_rad_s[0]) * 3000 && i < 300'000; ++i) x = x + 1e-9;
    u.torque_nm[0] = x;
  }
};
LITHE_LAW(Hostile, "slow_when_fast");
