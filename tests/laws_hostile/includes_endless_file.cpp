// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: uncompilable
// gate: includes
// Would let the compiler read for ever.
#include </dev/zero>
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    }
  }
};
LITHE_LAW(Hostile, "includes_endless_file");
