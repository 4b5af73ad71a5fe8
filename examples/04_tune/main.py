# SPDX-License-Identifier: Apache-2.0
"""Change a law's parameters while it runs: no compiler, one tick, all of a set or none."""

import lithe

with lithe.connect() as robot:
    robot.swap("laws/pd.cpp")
    for name, param in sorted(robot.params.get().items()):
        print(f"{name} in [{param['min']:g}, {param['max']:g}]")

    robot.params.set(kp_nm_rad=2.5, kd_nm_s_rad=0.2)
    print("kp is now", robot.params["kp_nm_rad"])

    try:
        robot.params.set(kp_nm_rad=3.0, kd_nm_s_rad=1e6)
    except lithe.Refused as error:
        print("refused:", error.code)
    print("kp is still", robot.params["kp_nm_rad"])
