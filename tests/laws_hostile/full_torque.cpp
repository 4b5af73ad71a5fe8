// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: clamp
// A million newton metres.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) u.torque_nm[j] = 1e6;
  }
};
LITHE_LAW(Hostile, "full_torque");
