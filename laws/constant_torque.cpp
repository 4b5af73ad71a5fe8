// SPDX-License-Identifier: Apache-2.0
// A constant torque on every joint, damped: torque = tau - kd dq. Moves a joint to where gravity balances it. This
// is how an unknown mgl is measured: at rest mgl sin(q) = tau (plus friction).
// Params: tau_nm the torque, kd_nm_s_rad damping that brings the joint to rest, ramp_s time to the full torque.
#include <lithe/law.hpp>

struct ConstantTorque {
  struct Params {
    lithe::Param tau_nm{0.0, -20.0, 20.0};
    lithe::Param kd_nm_s_rad{0.05, 0.0, 20.0};
    lithe::Param ramp_s{0.2, 0.001, 10.0};
  };
  struct State {
    double ramp = 0;  // 0..1
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    s.ramp = std::min(1.0, s.ramp + t.dt_s / p.ramp_s);
    for (std::uint32_t j = 0; j < t.joints; ++j)
      u.torque_nm[j] = s.ramp * p.tau_nm - p.kd_nm_s_rad * t.velocity_rad_s[j];
  }
};
LITHE_LAW(ConstantTorque, "constant_torque");
