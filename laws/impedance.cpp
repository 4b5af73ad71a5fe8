// SPDX-License-Identifier: Apache-2.0
// Joint impedance (Hogan 1985): the joint behaves like a mass M with a spring K and a damper D to the setpoint:
// torque = M ddq* + K (q* - q) + D (dq* - dq), with D = 2 zeta sqrt(K M) so that one number sets the damping.
// Params: inertia_kg_m2 M, stiffness_nm_rad K, damping_ratio zeta (1 = no overshoot), torque_limit_nm the largest
// torque of the spring, so that contact forces stay small.
#include <lithe/law.hpp>

struct Impedance {
  struct Params {
    lithe::Param inertia_kg_m2{0.003, 0.0001, 10.0};
    lithe::Param stiffness_nm_rad{2.0, 0.0, 200.0};
    lithe::Param damping_ratio{0.8, 0.0, 3.0};
    lithe::Param torque_limit_nm{1.0, 0.0, 100.0};
  };
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State&, lithe::Effort& u) {
    const double damping_nm_s_rad = 2 * p.damping_ratio * std::sqrt(p.stiffness_nm_rad * p.inertia_kg_m2);
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      const double spring_nm = p.stiffness_nm_rad * (t.setpoint_position_rad[j] - t.position_rad[j]);
      u.torque_nm[j] = p.inertia_kg_m2 * t.setpoint_acceleration_rad_s2[j] +
                       std::clamp<double>(spring_nm, -p.torque_limit_nm, p.torque_limit_nm) +
                       damping_nm_s_rad * (t.setpoint_velocity_rad_s[j] - t.velocity_rad_s[j]);
    }
  }
};
LITHE_LAW(Impedance, "impedance");
