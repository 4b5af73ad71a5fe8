# SPDX-License-Identifier: Apache-2.0
"""Stream a plan: every 20 ms the next 240 ms of a sine, as waypoints at absolute times. Then print the tracking error.

The Spine computes a smooth curve through the waypoints, so the Brain may be 200 ms late without an effect on the arm.

In another shell:  lithe run robots/arm.toml
Then:              .venv/bin/python examples/02_plan/main.py
"""

import math
import sys
import time
from pathlib import Path

import lithe  # before numpy: it limits numpy to one thread, so that none runs on the Spine's core
import numpy as np

LAWS = Path(__file__).resolve().parents[2] / "laws"
PERIOD_NS = 20_000_000


def reference_rad(t_s: float) -> float:
    """One slow swing to 90 degrees and back."""
    return math.pi / 4 * (1 - math.cos(math.pi * t_s))


try:
    with lithe.connect() as robot:
        robot.swap(LAWS / "gravity_pd.cpp", params={"mgl_nm": 0.165})
        robot.go_to([0.0], in_s=1.0)
        time.sleep(1.2)

        robot.telemetry.drain()
        start_ns = time.monotonic_ns()
        while (now_ns := time.monotonic_ns()) < start_ns + 4_000_000_000:
            times_ns = now_ns + PERIOD_NS * np.arange(1, 13)
            robot.publish(times_ns, [reference_rad((t_ns - start_ns) * 1e-9) for t_ns in times_ns])
            time.sleep(PERIOD_NS * 1e-9)

        records = robot.telemetry.drain()
        error_deg = np.degrees(records["setpoint_position_rad"][:, 0] - records["position_rad"][:, 0])
        highest_deg = float(np.degrees(records["position_rad"][:, 0].max()))
        print(
            f"the arm went up to {highest_deg:.0f} degrees"
            if abs(highest_deg - 90) > 3
            else "the arm went up to the horizontal"
        )
        print(f"RMSE below 2 degrees: {bool(np.sqrt(np.mean(error_deg**2)) < 2)}")
        print(f"records lost: {robot.telemetry.lost}")
except lithe.LitheError as error:
    sys.exit(str(error))  # what is wrong, where, and the next step
