// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Turns up its own gain beyond its range.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {
    lithe::Param kp_nm_rad{1, 0, 2};
  };
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    ((lithe::Param&)p.kp_nm_rad).value = 1e9;
    u.torque_nm[0] = -p.kp_nm_rad * t.position_rad[0] * 1e-9;
  }
};
LITHE_LAW(Hostile, "writes_its_params");
