# SPDX-License-Identifier: Apache-2.0
"""The demo's Brain process: streams a reference to the Spine and opens the gateway to the agent.

It publishes every 20 ms what the next 240 ms shall be. `reference` chooses what: rest where the robot is, or a sine.
Every change of reference fades in from the measured position, so that nothing jumps.
"""

from __future__ import annotations

import argparse
import json
import math
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import lithe
from lithe.gateway import Gateway, write_token

PERIOD_NS = 20_000_000
POINTS = 12
Vector = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Reference:
    """Angles [rad] over time [ns]: centre + amplitude sin(2 pi f (t - since) + phase), faded in from `start_rad`."""

    since_ns: int
    start_rad: Vector
    centre_rad: Vector
    amplitude_rad: Vector
    phase_rad: Vector
    frequency_hz: float = 0.0
    ramp_s: float = 1.0

    def at(self, t_ns: Sequence[int]) -> Vector:
        """Shape (times, joints)."""
        t = (np.asarray(t_ns, dtype=np.int64)[:, None] - self.since_ns) * 1e-9
        goal = self.centre_rad + self.amplitude_rad * np.sin(2 * math.pi * self.frequency_hz * t + self.phase_rad)
        x = np.clip(t / self.ramp_s, 0.0, 1.0)
        blend = x**3 * (10 - 15 * x + 6 * x * x)  # minimum jerk
        angles: Vector = self.start_rad + blend * (goal - self.start_rad)
        return angles


class ReferenceKeeper:
    """Holds the reference; the gateway's thread changes it, the main thread publishes it."""

    def __init__(self, robot: lithe.Robot) -> None:
        self._robot = robot
        self._lock = threading.Lock()
        self._reference = self._made({})

    def _made(self, args: dict[str, Any]) -> Reference:
        joints = self._robot.spine.joint_count
        record = self._robot.spine.latest()
        measured = np.zeros(joints) if record is None else np.array(record["position_rad"][:joints])

        def each(name: str, usual: Vector | float) -> Vector:
            return np.broadcast_to(np.asarray(args.get(name, usual), dtype=np.float64), joints)

        return Reference(
            time.monotonic_ns(),
            measured,
            each("centre_rad", measured),
            each("amplitude_rad", 0.0),
            each("phase_rad", 0.0),
            float(args.get("frequency_hz", 0.0)),
            float(args.get("ramp_s", 1.0)),
        )

    def set(self, args: dict[str, Any]) -> dict[str, Any]:
        """Gateway verb `reference`: {} rests; centre_rad, amplitude_rad, phase_rad, frequency_hz, ramp_s make a sine.

        The first three are a number for all joints, or one for each.
        """
        reference = self._made(args)
        with self._lock:
            self._reference = reference
        return {"since_ns": reference.since_ns}

    def publish(self) -> None:
        with self._lock:
            reference = self._reference
        first = (time.monotonic_ns() // PERIOD_NS + 1) * PERIOD_NS
        times = [first + i * PERIOD_NS for i in range(POINTS)]
        self._robot.publish(times, reference.at(times))


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m lithe.demo.brain")
    parser.add_argument("--token-file", type=Path, required=True)
    parser.add_argument("--reference", default="{}", help="JSON, as the gateway's verb `reference` takes it")
    args = parser.parse_args()
    robot = lithe.connect()
    keeper = ReferenceKeeper(robot)
    keeper.set(json.loads(args.reference))
    gateway = Gateway(robot, {"reference": keeper.set}, token=write_token(args.token_file))
    gateway.start()
    print(json.dumps({"port": gateway.port}), flush=True)
    while True:
        keeper.publish()
        time.sleep(PERIOD_NS * 1e-9)


if __name__ == "__main__":
    raise SystemExit(main())
