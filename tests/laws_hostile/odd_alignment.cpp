// SPDX-License-Identifier: Apache-2.0
// stopped-by: none
// without-gates: harmless
// Reads a double at an odd address: allowed by the machines LITHE runs on.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {
    std::array<std::uint8_t, 24> bytes{};
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    }
    u.torque_nm[0] += 1e-30 * *(const volatile double*)(s.bytes.data() + 1);
  }
};
LITHE_LAW(Hostile, "odd_alignment");
