# SPDX-License-Identifier: Apache-2.0
"""The gateway's verb `identify`: parameters from what telemetry has of a motion. Threads: pure functions."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from .._wire import Mode
from ..errors import Refused
from ..gateway.references import Limits
from .chain import ChainFit, identify_chain
from .joint import Motion
from .regressor import Description

Json = dict[str, Any]
GRAVITY_M_S2 = 9.81
FREQUENCIES_HZ = (0.3, 0.7, 1.1, 1.9)
SHARE = 0.5  # of each limit
COUPLED = "torque of a joint = the equations of the document chain, all joints at once"
SINGLE = (
    "torque = (inertia) * acceleration + viscous * velocity + coulomb * sign(velocity) + gravity * sin(position), "
    "each joint by itself: wrong where another joint's motion moves it"
)


def identified(records: npt.NDArray[Any], names: list[str], chain: Json | None, limits: Limits) -> Json:
    """`parameters`, each with its 95 % interval; where the motion tells too little, Refused with a motion that does.

    `records`: every tick, oldest first. Only those in mode active count.
    """
    records = records[records["mode"] == Mode.active]
    moved: Json = {}
    if len(records):
        position, velocity = records["position_rad"], records["velocity_rad_s"]
        moved = {
            name: {"range_rad": round(float(np.ptp(position[:, j])), 4),
                   "most_rad_s": round(float(np.abs(velocity[:, j]).max()), 4)}
            for j, name in enumerate(names)
        }  # fmt: skip
    try:
        if len(records) < 2:
            raise ValueError("no tick of the mode active is there")
        t_s = 1e-9 * (records["sample_ns"] - records["sample_ns"][0]).astype(np.float64)
        motions = [Motion(t_s, *(np.asarray(records[field][:, j], dtype=np.float64)
                                 for field in ("position_rad", "velocity_rad_s", "torque_nm")))
                   for j in range(len(names))]  # fmt: skip
        fits = _fits(names, chain, motions)
    except (ValueError, np.linalg.LinAlgError) as error:
        needed = motion_needed(limits)
        raise Refused(
            "motion_tells_too_little", str(error), "set_reference with detail.needs, wait 5 s, then identify again",
            {"needs": needed, "moved": moved},
        ) from None  # fmt: skip
    warnings = [words for fit in fits for words in fit.warnings]
    return {
        "seconds": round(float(t_s[-1]), 3),
        "model": COUPLED if chain else SINGLE,
        "parameters": [each for fit in fits for each in _parameters(fit, bool(chain))],
        "residual_nm": {name: _short(value) for fit in fits for name, value in fit.residual_nm.items()},
        "moved": moved,
    } | ({"warnings": warnings, "needs": motion_needed(limits)} if warnings else {})


def motion_needed(limits: Limits) -> Json:
    """Arguments of set_reference: four frequencies on each joint, within half of its limits."""
    half = (limits.most_rad - limits.least_rad) / 2
    # The sum of the phases' speeds is at most that of all frequencies at once.
    fast = limits.speed_rad_s / (2 * np.pi * float(np.mean(FREQUENCIES_HZ)) * 2)
    amplitude = SHARE * np.minimum(half, fast)
    return {
        "kind": "multisine",
        "centre_rad": [round(float(each), 3) for each in (limits.most_rad + limits.least_rad) / 2],
        "amplitude_rad": [round(float(each), 3) for each in amplitude],
        "frequency_hz": list(FREQUENCIES_HZ),
        "client_stale_s": 60,
    }


def _fits(names: list[str], chain: Json | None, motions: list[Motion]) -> list[ChainFit]:
    """Of a chain one of all joints; else one of each joint: a chain of one link."""
    if chain:
        return [identify_chain(Description(**chain), [motions])]
    return [
        identify_chain(Description((name,), (0.0,), GRAVITY_M_S2), [[motion]])
        for name, motion in zip(names, motions, strict=True)
    ]


def _parameters(fit: ChainFit, coupled: bool) -> list[Json]:
    told = []
    for each in fit.parameters:
        factor, name, unit = 1.0, each.name, each.unit
        if name == "moment" and not coupled:
            factor, name, unit = GRAVITY_M_S2, "gravity", "N m"
        values = {"value": each.value, "low": each.low, "high": each.high}
        told.append({"joint": each.joint, "name": name, "unit": unit}
                    | {key: _short(factor * value) for key, value in values.items()})  # fmt: skip
    return told


def _short(value: float) -> float:
    return float(f"{value:.4g}")
