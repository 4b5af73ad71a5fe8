// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: attributes
// A constructor function, in the standard's spelling.
#include <lithe/law.hpp>

int early_value = 0;
[[gnu::constructor]] void early() { early_value = 1; }

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    }
  }
};
LITHE_LAW(Hostile, "constructor_by_standard_attribute");
