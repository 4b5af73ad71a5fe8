// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Keeps one number per joint in an array of one.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {
    std::array<double, 1> sum{};
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints + 2; ++j) ((volatile double*)s.sum.data())[j] = t.position_rad[j];
    u.torque_nm[0] = s.sum[0] * 1e-3;
  }
};
LITHE_LAW(Hostile, "trusts_the_joint_count");
