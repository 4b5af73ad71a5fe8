# SPDX-License-Identifier: Apache-2.0
"""Which multisine tells most of a chain: a seeded random search for the largest determinant of the information matrix
(D-optimal; Swevers et al., IEEE Transactions on Robotics and Automation 13, 1997), inside the joints' limits.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..gateway.curves import HIGHEST_HZ, curve_of
from ..gateway.references import Limits
from .chain import MOVING_RAD_S, WINDOW_S
from .joint import Vector
from .regressor import Description, names_of, rows_of

STEP_S = 0.004
CANDIDATES = 60
MARGIN = 0.9  # of each limit


def information(chain: Description, args: dict[str, Any], seconds: float) -> float:
    """Log determinant of the information matrix of a reference that is followed exactly; -inf: it is singular."""
    t: Vector = np.arange(0.0, seconds, STEP_S, dtype=np.float64)
    q = curve_of(args, len(chain.names))(t)
    v = np.gradient(q, STEP_S, axis=0)
    rows = rows_of(chain, t, q, v, np.zeros_like(q), WINDOW_S, MOVING_RAD_S)
    told = rows.a[:, [name != "delay" for _, name, _ in names_of(chain)]]  # that of a delay depends on the torque
    sign, size = np.linalg.slogdet(told.T @ told)
    return float(size) if sign > 0 and np.isfinite(size) else -np.inf


def design_multisine(
    chain: Description,
    limits: Limits,
    seconds: float = 20.0,
    seed: int = 0,
    candidates: int = CANDIDATES,
    acceleration_rad_s2: Vector | float = np.inf,
) -> dict[str, Any]:
    """Arguments for the verb `set_reference` (kind `multisine`), and `information`: larger tells more.

    limits: of position [rad] and velocity [rad/s]; `acceleration_rad_s2`: one for all joints, or for each, of the
    reference alone. Nine tenths of all of them are used at most. The same seed gives the same
    answer. ValueError where the limits leave no motion that tells all parameters.
    """
    rng = np.random.default_rng(seed)
    half = (limits.most_rad - limits.least_rad) / 2
    middle = (limits.most_rad + limits.least_rad) / 2
    t: Vector = np.arange(0.0, seconds, STEP_S, dtype=np.float64)
    best: dict[str, Any] | None = None
    most = -np.inf
    for _ in range(candidates):
        base_hz = round(rng.uniform(0.1, 0.3), 4)  # all of them have its period
        many = int(rng.integers(3, 9))
        turns = np.sort(rng.choice(np.arange(1, 16), size=many, replace=False))
        args: dict[str, Any] = {
            "kind": "multisine",
            "centre_rad": (middle + rng.uniform(-0.3, 0.3, len(half)) * half).tolist(),
            "frequency_hz": [round(float(hz), 4) for hz in base_hz * turns if hz <= HIGHEST_HZ],
        }
        centre = np.asarray(args["centre_rad"])
        unit = curve_of({**args, "amplitude_rad": np.ones(len(half)).tolist()}, len(half))(t) - centre
        room = MARGIN * (half - np.abs(centre - middle)) / np.abs(unit).max(axis=0)
        speed = np.gradient(unit, STEP_S, axis=0)
        fast = MARGIN * limits.speed_rad_s / np.abs(speed).max(axis=0)
        hard = MARGIN * acceleration_rad_s2 / np.abs(np.gradient(speed, STEP_S, axis=0)).max(axis=0)
        args["amplitude_rad"] = [round(float(each), 4) for each in np.minimum(np.minimum(room, fast), hard)]
        told = information(chain, args, seconds)
        if told > most:
            best, most = args, told
    if best is None:
        raise ValueError(
            "no multisine inside these limits tells all parameters: give the joints more room, or more time"
        )
    return {"reference": best, "information": most}
