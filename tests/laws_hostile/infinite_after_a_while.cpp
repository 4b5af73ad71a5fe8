// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: clamp
// A gain that doubles at every step.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {
    double gain = 1e-9;
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    s.gain *= 2;
    u.torque_nm[0] = s.gain;
  }
};
LITHE_LAW(Hostile, "infinite_after_a_while");
