# SPDX-License-Identifier: Apache-2.0
"""What was measured of a law, and what makes one better than another. Pure functions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

SCORES = {"rms": "RMS error [deg]", "max": "largest error [deg]", "torque": "RMS torque [N m]"}
LEAST_GAIN = 0.99  # of the score, that makes a law the new best
MOST_WORSE, FREE_DEG = 2.0, 0.1  # no joint of a new best may become so many times worse, beyond so much
AS_GOOD = 1.1  # times the error of each joint under the law at the start, that a law of less torque may have


@dataclass(frozen=True)
class Measured:
    """What the verb `measure` said of one law, joint by joint; errors at the instants of the samples."""

    law_id: int
    rms_deg: list[float]
    max_deg: list[float]
    torque_nm: list[float]

    @staticmethod
    def of(told: dict[str, Any], names: list[str]) -> Measured:
        """From the answer of `measure`."""

        def column(key: str) -> list[float]:
            return [float(told["joints"][name][key]) for name in names]

        return Measured(
            int(told["law_id"]),
            [math.degrees(each) for each in column("rms_error_rad")],
            [math.degrees(each) for each in column("max_error_rad")],
            column("rms_torque_nm"),
        )

    def joints(self, kind: str) -> list[float]:
        """Of each joint, that on which the score is made."""
        return {"rms": self.rms_deg, "max": self.max_deg, "torque": self.torque_nm}[kind]


def score(told: Measured | None, kind: str) -> float:
    """Of all joints: the smaller the better; in the unit that SCORES has. Not measured: infinite."""
    if told is None:
        return math.inf
    values = told.joints(kind)
    return max(values) if kind == "max" else float(np.sqrt(np.mean(np.square(values))))


def better(new: Measured, best: Measured | None, start: Measured | None, kind: str) -> bool:
    """All joints together, and no joint at the others' cost; less torque only where no joint follows worse."""
    if best is None or start is None or score(new, kind) >= LEAST_GAIN * score(best, kind):
        return False
    if kind == "torque":
        return all(one <= AS_GOOD * old for one, old in zip(new.rms_deg, start.rms_deg, strict=True))
    worse = [one > MOST_WORSE * old + FREE_DEG for one, old in zip(new.joints(kind), best.joints(kind), strict=True)]
    return not any(worse)
