// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: not_finite
// The square root of a negative number.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = std::sqrt(-1 - t.t_s);
  }
};
LITHE_LAW(Hostile, "nan_always");
