// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: bad_access
// Writes through a null pointer.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    *(volatile double*)nullptr = t.position_rad[0];
  }
};
LITHE_LAW(Hostile, "writes_null");
