// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: memory
// A ring of past samples in a static array.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    static std::array<double, 64> past{};
    u.torque_nm[0] = past[t.tick % 64] - t.position_rad[0];
    past[t.tick % 64] = t.position_rad[0];
  }
};
LITHE_LAW(Hostile, "static_array");
