// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: harmless
// gate: words
// Compiles to something else where a file exists.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
#if __has_include(</etc/shadow>)
    u.torque_nm[0] = 1;
#endif
  }
};
LITHE_LAW(Hostile, "looks_at_the_disk");
