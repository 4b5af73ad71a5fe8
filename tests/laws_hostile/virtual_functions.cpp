// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: harmless
// gate: words
// Calls through virtual functions.
#include <lithe/law.hpp>

struct Spring {
  virtual double torque(double x) const = 0;
};
struct Stiff : Spring {
  double torque(double x) const override { return -0.1 * x; }
};

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    const Stiff stiff;
    const Spring& spring = stiff;
    u.torque_nm[0] = spring.torque(t.position_rad[0]);
  }
};
LITHE_LAW(Hostile, "virtual_functions");
