# SPDX-License-Identifier: Apache-2.0
"""Write a control law as text, swap it in while the robot runs, and see what happens to one that is wrong."""

import lithe

DAMPED = """
#include <lithe/law.hpp>
struct Damped {
  struct Params {
    lithe::Param kd_nm_s_rad{0.05, 0.0, 1.0};
  };
  struct State {};
  static void step(const lithe::Tick& t, const Params& p, State&, lithe::Effort& u) {
    for (std::size_t j = 0; j < t.joints; ++j) u.torque_nm[j] = -p.kd_nm_s_rad * t.velocity_rad_s[j];
  }
};
LITHE_LAW(Damped, "damped");
"""

with lithe.connect() as robot:
    record = robot.swap(DAMPED, name="damped.cpp")
    print("committed:", record["law"], "verdict:", record["verdict"])

    try:
        robot.swap(DAMPED.replace("t.velocity_rad_s[j]", "t.speed[j]"), name="typo.cpp")
    except lithe.Refused as error:
        print("refused:", error.code)
        print("the compiler says:", "has no member named" in str(error.detail))

    print("still runs:", robot.status()["law"])
    robot.rollback()
    print("after the rollback it runs another law:", robot.status()["law"] != "damped")
