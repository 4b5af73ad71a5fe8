// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unloadable
// gate: preprocessor
// Redefines the macro that exports the law.
#include <lithe/law.hpp>
#undef LITHE_LAW
#define LITHE_LAW(Type, name) extern "C" const LitheLaw lithe_law = {}

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    }
  }
};
LITHE_LAW(Hostile, "redefines_the_contract");
