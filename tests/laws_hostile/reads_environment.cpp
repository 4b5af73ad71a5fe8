// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: calls
// Reads the environment of the process.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    const char* home = std::getenv("HOME");
    u.torque_nm[0] = home == nullptr ? 0 : home[0] * 1e-3;
  }
};
LITHE_LAW(Hostile, "reads_environment");
