# SPDX-License-Identifier: Apache-2.0
"""Write a law of your own: PD plus an integral, with State that survives a swap, live Params and a probe.

In another shell:  lithe run robots/arm.toml
Then:              .venv/bin/python examples/04_law/main.py
"""

import math
import sys
import time

import lithe

LAW = """
#include <lithe/law.hpp>

struct Pid {
  struct Params {
    lithe::Param kp_nm_rad{2.0, 0.0, 20.0}, ki_nm_rad_s{0.0, 0.0, 20.0}, kd_nm_s_rad{0.1, 0.0, 2.0};
  };
  struct State {
    double integral_rad_s = 0;  // a later law with a field of this name and type takes over its value
  };
  struct Probes {
    double integral_nm = 0;  // in telemetry as probe[0]
  };
  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u, Probes& probe) {
    const double error_rad = t.setpoint_position_rad[0] - t.position_rad[0];
    if (p.ki_nm_rad_s > 0) s.integral_rad_s = std::clamp(s.integral_rad_s + error_rad * t.dt_s, -0.2, 0.2);
    probe.integral_nm = p.ki_nm_rad_s * s.integral_rad_s;
    u.torque_nm[0] = p.kp_nm_rad * error_rad + probe.integral_nm - p.kd_nm_s_rad * t.velocity_rad_s[0];
  }
};
LITHE_LAW(Pid, "pid");
"""


def sag_deg(robot: lithe.Robot) -> float:
    """How far below the setpoint the arm hangs."""
    time.sleep(3.0)
    now = robot.telemetry.latest()
    return math.degrees(now["setpoint_position_rad"][0] - now["position_rad"][0])


try:
    with lithe.connect() as robot:
        # error_ratio=0: the arm sags at first, so the probation must not judge the tracking error.
        robot.swap(LAW, name="pid.cpp", error_ratio=0)
        robot.go_to([math.pi / 2], in_s=1.0)
        print(f"PD alone sags by more than 3 degrees: {sag_deg(robot) > 3}")

        robot.params["ki_nm_rad_s"] = 2.0  # between two ticks; nothing is compiled
        print(f"with the integral less than 1 degree: {abs(sag_deg(robot)) < 1}")

        probe_nm = float(robot.telemetry.latest()["probe"][0])
        # The robot file says 0.165; payload, friction and the drive's torque constant change it.
        print(f"the integral has learnt the arm's weight, 0.12 to 0.23 N m: {0.12 < probe_nm < 0.23}")
except lithe.LitheError as error:
    sys.exit(str(error))  # what is wrong, where, and the next step
