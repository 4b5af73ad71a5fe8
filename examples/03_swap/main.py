# SPDX-License-Identifier: Apache-2.0
"""Swap the law of an arm under load, look at the torque around the commit, and roll back.

In another shell:  lithe run robots/arm.toml
Then:              .venv/bin/python examples/03_swap/main.py
"""

import sys
import time
from pathlib import Path

import lithe  # before numpy: it limits numpy to one thread, so that none runs on the Spine's core
import numpy as np

LAWS = Path(__file__).resolve().parents[2] / "laws"


def step_nm(robot: lithe.Robot, tick: int) -> float:
    """Largest change of the torque from one tick to the next, around that tick."""
    time.sleep(0.1)
    records = robot.telemetry.history(2.0)
    near = records[np.abs(records["tick"].astype(int) - tick) < 5]
    return float(np.max(np.abs(np.diff(near["command_torque_nm"][:, 0]))))


try:
    with lithe.connect() as robot:
        info = robot.spine.info
        bound_nm = float(info["torque_slew_nm_s"][0] / info["rate_hz"])

        robot.swap(LAWS / "pd.cpp")
        robot.go_to([0.8], in_s=1.0)
        time.sleep(1.5)

        for law in ("gravity_pd", "impedance", "lqr"):
            swap = robot.swap(LAWS / f"{law}.cpp")
            inside = step_nm(robot, swap["commit_tick"]) <= bound_nm * 1.001
            print(f"{law}: runs; torque step within the guard's bound: {inside}")

        robot.rollback()
        print(f"rolled back to {robot.status()['law']}")
except lithe.LitheError as error:
    sys.exit(str(error))  # what is wrong, where, and the next step
