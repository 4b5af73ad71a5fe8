// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Counts to the capacity of the arrays instead of the joints of the robot.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params&, State&, lithe::Effort& u) {
    for (std::size_t j = 0; j < lithe::kMaxJoints; ++j) u.torque_nm[j] = 0.01 - 0.05 * t.velocity_rad_s[j];
  }
};
LITHE_LAW(Hostile, "writes_past_the_joints");
