# SPDX-License-Identifier: Apache-2.0
"""Connect to a running robot, move it a little, and hold it there. First: lithe run robots/arm.toml"""

import time

import lithe

with lithe.connect() as robot:
    print("robot:", robot.name, "joints:", robot.spine.joint_names)
    robot.swap("laws/gravity_pd.cpp", params={"mgl_nm": 0.165, "kp_nm_rad": 6.0, "kd_nm_s_rad": 0.2})

    robot.go_to([0.5], in_s=0.5)  # a plan of one waypoint: be there in half a second, and rest
    time.sleep(1.0)
    print("mode after hold:", robot.hold()["mode"])  # the setpoint rests; the law goes on

    record = robot.telemetry.latest()
    assert record is not None
    print(f"within 2 degrees of 0.5 rad: {abs(float(record['position_rad'][0]) - 0.5) < 0.035}")
    print("mode after arm:", robot.arm()["mode"])
