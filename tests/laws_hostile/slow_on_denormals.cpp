// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// A hundred times slower when its input is a denormal number. It looks at the bits: as a number it would be 0.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    volatile double x = t.position_rad[0];
    std::uint64_t bits = 0;
    std::memcpy(&bits, &t.position_rad[0], sizeof bits);
    bits <<= 1;  // without its sign
    const bool denormal = bits != 0 && bits >> 53 == 0;
    const int rounds = denormal ? 2'000'000 : 20'000;
    for (int i = 0; i < rounds; ++i) x = x * 0.999999;
    u.torque_nm[0] = 1e-3 * x;
  }
};
LITHE_LAW(Hostile, "slow_on_denormals");
