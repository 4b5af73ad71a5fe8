// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: clamp
// Full torque, another way at each tick.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) u.torque_nm[j] = t.tick % 2 == 0 ? 100 : -100;
  }
};
LITHE_LAW(Hostile, "torque_chatter");
