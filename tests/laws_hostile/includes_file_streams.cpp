// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: includes
// Logs into a file at every step.
#include <fstream>
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    std::ofstream("/dev/null") << t.position_rad[0];
  }
};
LITHE_LAW(Hostile, "includes_file_streams");
