# SPDX-License-Identifier: Apache-2.0
"""Stream a sine as a horizon of waypoints, and read back how well the arm followed it."""

import math
import time

import lithe
import numpy as np

PERIOD_NS = 20_000_000  # a new horizon every 20 ms
POINTS = 12  # that reaches 240 ms ahead: a pause of the Brain that long goes unnoticed

with lithe.connect() as robot:
    robot.swap("laws/gravity_pd.cpp", params={"mgl_nm": 0.165, "kp_nm_rad": 6.0, "kd_nm_s_rad": 0.2})
    start_ns = time.monotonic_ns()
    while time.monotonic_ns() - start_ns < 3e9:
        first_ns = (time.monotonic_ns() // PERIOD_NS + 1) * PERIOD_NS
        times_ns = [first_ns + i * PERIOD_NS for i in range(POINTS)]
        robot.publish(times_ns, [0.6 * math.sin(math.pi * (t - start_ns) * 1e-9) for t in times_ns])
        time.sleep(PERIOD_NS * 1e-9)

    records = robot.telemetry.history(1.5)
    error_rad = records["setpoint_position_rad"][:, 0] - records["position_rad"][:, 0]
    print("records of the last 1.5 s:", "enough" if len(records) > 1000 else len(records))
    print("RMSE below 3 degrees:", bool(np.degrees(np.sqrt(np.mean(error_rad**2))) < 3.0))
