// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: clamp
// Full torque by the sign of a noisy velocity.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) u.torque_nm[j] = t.velocity_rad_s[j] > 0 ? -50 : 50;
  }
};
LITHE_LAW(Hostile, "bang_bang");
