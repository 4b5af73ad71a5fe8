// SPDX-License-Identifier: Apache-2.0
// Linear-quadratic tracking of each joint as a double integrator J ddq = torque, in closed form: for the cost
// integral of (w_q e^2 + w_v de^2 + w_u torque^2) the Riccati equation has the solution
// kp = sqrt(w_q / w_u), kd = sqrt((w_v + 2 J sqrt(w_q w_u)) / w_u) (Anderson and Moore, Optimal Control, ch. 3).
// Params: inertia_kg_m2 J, weights w_position [1/rad2], w_velocity [s2/rad2], w_effort [1/(Nm)2]. All joints alike.
#include <lithe/law.hpp>

struct Lqr {
  struct Params {
    lithe::Param inertia_kg_m2{0.003, 0.0001, 10.0};
    lithe::Param w_position{16.0, 0.0, 1e6};
    lithe::Param w_velocity{0.01, 0.0, 1e6};
    lithe::Param w_effort{1.0, 0.001, 1e6};
  };
  struct State {};
  struct Probes {
    double kp_nm_rad = 0, kd_nm_s_rad = 0;  // the gains that result from the weights
  };

  static void step(const lithe::Tick& t, const Params& p, State&, lithe::Effort& u, Probes& k) {
    k.kp_nm_rad = std::sqrt(p.w_position / p.w_effort);
    k.kd_nm_s_rad = std::sqrt((p.w_velocity + 2 * p.inertia_kg_m2 * std::sqrt(p.w_position * p.w_effort)) / p.w_effort);
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = p.inertia_kg_m2 * t.setpoint_acceleration_rad_s2[j] +
                       k.kp_nm_rad * (t.setpoint_position_rad[j] - t.position_rad[j]) +
                       k.kd_nm_s_rad * (t.setpoint_velocity_rad_s[j] - t.velocity_rad_s[j]);
    }
  }
};
LITHE_LAW(Lqr, "lqr");
