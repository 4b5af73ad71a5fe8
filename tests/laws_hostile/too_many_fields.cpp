// SPDX-License-Identifier: Apache-2.0
// stopped-by: compile
// without-gates: uncompilable
// 40 fields in State.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {
    double f0 = 0;
    double f1 = 0;
    double f2 = 0;
    double f3 = 0;
    double f4 = 0;
    double f5 = 0;
    double f6 = 0;
    double f7 = 0;
    double f8 = 0;
    double f9 = 0;
    double f10 = 0;
    double f11 = 0;
    double f12 = 0;
    double f13 = 0;
    double f14 = 0;
    double f15 = 0;
    double f16 = 0;
    double f17 = 0;
    double f18 = 0;
    double f19 = 0;
    double f20 = 0;
    double f21 = 0;
    double f22 = 0;
    double f23 = 0;
    double f24 = 0;
    double f25 = 0;
    double f26 = 0;
    double f27 = 0;
    double f28 = 0;
    double f29 = 0;
    double f30 = 0;
    double f31 = 0;
    double f32 = 0;
    double f33 = 0;
    double f34 = 0;
    double f35 = 0;
    double f36 = 0;
    double f37 = 0;
    double f38 = 0;
    double f39 = 0;
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    }
  }
};
LITHE_LAW(Hostile, "too_many_fields");
