# SPDX-License-Identifier: Apache-2.0
"""Learn a small network on the simulated arm, write it as a law in C++, and swap it into the running arm.

In another shell:  lithe run robots/arm.toml
Then:              .venv/bin/python examples/06_policy/main.py [CANDIDATES]
It needs gymnasium and cma: .venv/bin/pip install gymnasium cma
"""

import sys
import time

import lithe  # before numpy: it limits numpy to one thread, so that none runs on the Spine's core
import numpy as np
from network import Floats

WORDS = sys.argv[1:] or ["640"]
if len(WORDS) > 1 or not WORDS[0].isdecimal() or int(WORDS[0]) == 0:
    sys.exit(f"CANDIDATES is how many networks are tried, not {' '.join(WORDS)}\n  next: main.py 640")
CANDIDATES = int(WORDS[0])


def measure(robot: lithe.Robot) -> tuple[float, Floats]:
    """Up to 1 rad and back: root mean square of the tracking error [deg], and the records of it."""
    for target_rad in (1.0, 0.0):
        robot.go_to([target_rad], in_s=0.8)
        time.sleep(1.0)
    records = robot.telemetry.history(1.9)
    error_rad = (records["setpoint_position_rad"] - records["position_rad"])[:, 0]
    return float(np.degrees(np.sqrt(np.mean(error_rad**2)))), records


try:
    from learn import FIELDS, learn

    with lithe.connect() as robot:
        print(
            f"trying {CANDIDATES} networks on the simulated arm: about {CANDIDATES / 4:.0f} s, more on a busy computer",
            flush=True,
        )
        network, torque_max_nm = learn(CANDIDATES)
        before_deg, _ = measure(robot)
        before = robot.status()["law"]
        swap = robot.swap(network.law(torque_max_nm), name="policy.cpp", error_ratio=0)
        after_deg, records = measure(robot)
        seen = [records[field][:, :1].astype(float) for field in FIELDS]
        apart_nm = records["law_torque_nm"][:, :1] - torque_max_nm * network.share(*seen)
        size = next(gate["detail"] for gate in swap["gates"] if gate["gate"] == "size")
        print(f"at most 4096 bytes of code: {int(size.split()[0]) <= 4096} ({size})")
        print(f"the law gives the network's torques: {np.max(np.abs(apart_nm)) < 1e-9}")
        print(f"the policy tracks better: {after_deg < before_deg}")
        print(f"tracking error (rms): {before} {before_deg:.2f} deg, {swap['law']} {after_deg:.2f} deg")
except lithe.LitheError as error:
    sys.exit(str(error))  # what is wrong, where, and the next step
