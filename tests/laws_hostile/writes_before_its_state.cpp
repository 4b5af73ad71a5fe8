// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Writes before the beginning of its state.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {
    double a = 0, b = 0;
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    ((volatile double*)&s)[-1 - static_cast<int>(t.tick % 4)] = 1e9;
    u.torque_nm[0] = s.a;
  }
};
LITHE_LAW(Hostile, "writes_before_its_state");
