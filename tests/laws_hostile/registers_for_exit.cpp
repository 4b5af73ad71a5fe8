// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: calls
// Leaves a function behind that is called when the process ends.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = std::atexit([] {});
  }
};
LITHE_LAW(Hostile, "registers_for_exit");
