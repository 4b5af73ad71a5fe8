// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Reads a local array it never wrote.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    volatile double junk[64];
    u.torque_nm[0] = std::clamp(junk[t.tick % 64] * 1e300, -0.01, 0.01);
  }
};
LITHE_LAW(Hostile, "reads_uninitialised_memory");
