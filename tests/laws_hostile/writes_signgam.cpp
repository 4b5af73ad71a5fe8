// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: harmless
// gate: calls
// std::lgamma writes a global variable of the library.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = 1e-3 * std::lgamma(2 + t.position_rad[0] * t.position_rad[0]);
  }
};
LITHE_LAW(Hostile, "writes_signgam");
