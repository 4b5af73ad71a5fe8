// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: calls
// Extended precision, which other machines do not have.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = static_cast<double>(1e-3L * std::sin(static_cast<long double>(t.position_rad[0])));
  }
};
LITHE_LAW(Hostile, "long_double");
