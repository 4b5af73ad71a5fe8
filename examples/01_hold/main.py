# SPDX-License-Identifier: Apache-2.0
"""Connect, see where the arm is, swap in a law that holds it there.

In another shell:  lithe run robots/arm.toml
Then:              .venv/bin/python examples/01_hold/main.py
"""

import math
import sys
import time
from pathlib import Path

import lithe

LAWS = Path(__file__).resolve().parents[2] / "laws"

try:
    with lithe.connect() as robot:
        # error_ratio=0: this law ignores plans on purpose, so the probation must not judge its tracking error.
        swap = robot.swap(LAWS / "hold.cpp", error_ratio=0)
        print(f"law '{swap['law']}' runs, mode {robot.status()['mode']}")

        before = robot.telemetry.latest()
        robot.go_to([math.radians(60)], in_s=0.5)  # the law ignores the plan: it holds where it took over
        time.sleep(1.0)
        after = robot.telemetry.latest()

        moved_deg = math.degrees(abs(after["position_rad"][0] - before["position_rad"][0]))
        print(f"moved {moved_deg:.0f} degrees though the plan asked for 60")
except lithe.LitheError as error:
    sys.exit(str(error))  # what is wrong, where, and the next step
