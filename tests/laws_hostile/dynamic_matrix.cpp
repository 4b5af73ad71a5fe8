// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: calls
// An Eigen matrix whose size is known at run time only.
#include <Eigen/Core>
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    Eigen::MatrixXd m(t.joints, t.joints);
    m.setConstant(t.position_rad[0]);
    u.torque_nm[0] = m.trace();
  }
};
LITHE_LAW(Hostile, "dynamic_matrix");
