// SPDX-License-Identifier: Apache-2.0
// For loader_test: divides by the velocity, which is zero in the first dry steps.
#include <lithe/law.hpp>

struct NotFinite {
  struct Params {};
  struct State {};
  static void step(const lithe::Tick& t, const Params&, State&, lithe::Effort& u) {
    u.torque_nm[0] = 1.0 / t.velocity_rad_s[0];
  }
};
LITHE_LAW(NotFinite, "not_finite");
