// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: harmless
// gate: stack
// An array whose length comes from the input.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    volatile double some[t.joints * 100];
    some[t.tick % t.joints] = t.position_rad[0];
    u.torque_nm[0] = some[t.tick % t.joints] * 1e-3;
  }
};
LITHE_LAW(Hostile, "variable_length_array");
