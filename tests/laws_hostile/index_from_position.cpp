// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Looks up a table by the position, without looking at the range.
#include <lithe/law.hpp>

constexpr std::array<float, 8000> kTable{1, 2, 3};

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = 1e-3 * kTable[static_cast<int>(t.position_rad[0] * 1000) + 4000];
  }
};
LITHE_LAW(Hostile, "index_from_position");
