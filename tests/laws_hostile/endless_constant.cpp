// SPDX-License-Identifier: Apache-2.0
// stopped-by: compile
// without-gates: uncompilable
// A constant that takes for ever to compute.
#include <lithe/law.hpp>

constexpr int forever() {
  int n = 0;
  while (true) n ^= 1;
  return n;
}

struct Hostile {
  struct Params {};
  struct State {};

  static constexpr int kForever = forever();
  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) { u.torque_nm[0] = kForever; }
};
LITHE_LAW(Hostile, "endless_constant");
