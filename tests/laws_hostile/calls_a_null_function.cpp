// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: bad_access
// gate: stack
// Calls through a pointer that points nowhere.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    double (*volatile f)(double) = nullptr;
    u.torque_nm[0] = f(t.position_rad[0]);
  }
};
LITHE_LAW(Hostile, "calls_a_null_function");
