// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: words
// Dithers with the C library's random numbers.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = 1e-6 * std::rand();
  }
};
LITHE_LAW(Hostile, "random_numbers");
