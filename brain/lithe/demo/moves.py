# SPDX-License-Identifier: Apache-2.0
"""How the agent moves a joint within what the gateway tells of it: the sine it tracks, the torques it is probed with.

Angle 0 hangs straight down, as everywhere in LITHE; so gravity pulls hardest at a right angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lithe.identify import Arm, Motion

FREQUENCY_HZ = 0.5
RAMP_S = 1.5
WIDEST_RAD = np.pi / 4
MARGIN_RAD = 0.15  # off a position limit: close to one the guard takes away what pushes outwards, so holds no weight
SHARE_OF_RANGE, SHARE_OF_SPEED = 0.4, 0.4  # that a sine may take
# Of the rough gravity torque. The first pair is a wide swing both ways that cannot go over the top. Where the limits
# leave no room for it, another may fit.
PROBE_SHARES = (0.5, -0.35)
PROBES = (PROBE_SHARES, (-0.5, 0.35), (0.5, 0.25), (-0.5, -0.25))
OVER_THE_TOP_RAD = np.radians(120)


def heaviest_rad(least_rad: float, most_rad: float) -> float:
    """The angle between these two at which gravity pulls hardest; of several the one nearest to hanging."""
    turns = np.pi / 2 + np.pi * np.arange(np.ceil(least_rad / np.pi - 0.5), np.floor(most_rad / np.pi - 0.5) + 1)
    return float(
        min((*turns, most_rad, least_rad), key=lambda q_rad: (-round(abs(np.sin(q_rad)), 9), abs(q_rad), -q_rad))
    )


def phase_rad(loaded_rad: float, centre_rad: float, amplitude_rad: float) -> float:
    """The phase with which half a turn of the sine is at that angle, or next to it, on the way that gravity pulls."""
    asked = float(np.arcsin(np.clip((loaded_rad - centre_rad) / amplitude_rad, -1.0, 1.0)))
    return -asked if np.sin(loaded_rad) >= 0 else asked - float(np.pi)


def sines(joints: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What the verb `set_reference` takes: for each joint a sine about the heaviest place within its limits.

    The phases are such that all joints come through their heaviest angle at once, on their way down.
    """
    centres, amplitudes, phases = [], [], []
    for joint in joints:
        least_rad = float(joint["position_min_rad"]) + MARGIN_RAD
        most_rad = float(joint["position_max_rad"]) - MARGIN_RAD
        if not most_rad > least_rad:
            raise ValueError(f"joint '{joint['name']}' has no room to move: its position limits are too close")
        speed_rad = float(joint["velocity_max_rad_s"]) / (2 * np.pi * FREQUENCY_HZ)
        amplitude = min(WIDEST_RAD, SHARE_OF_RANGE * (most_rad - least_rad), SHARE_OF_SPEED * speed_rad)
        loaded_rad = heaviest_rad(least_rad, most_rad)
        centre = float(np.clip(loaded_rad, least_rad + amplitude, most_rad - amplitude))
        centres.append(centre)
        amplitudes.append(amplitude)
        phases.append(phase_rad(loaded_rad, centre, amplitude))
    return {
        "kind": "sine",
        "centre_rad": centres,
        "amplitude_rad": amplitudes,
        "phase_rad": phases,
        "frequency_hz": FREQUENCY_HZ,
        "ramp_s": RAMP_S,
    }


def _stays(arm: Arm, share: float, starts: list[tuple[float, float]], least_rad: float, most_rad: float) -> bool:
    """True when a constant torque keeps the joint between two angles, from wherever (angle, speed) it starts.

    By energy, over mgl: there it has more than friction leaves of it. Only half of the friction is relied on.
    """
    friction = 0.5 * max(arm.coulomb_nm, 0.0) / arm.mgl_nm
    for q_rad, v_rad_s in starts:
        energy = 1 - np.cos(q_rad) - share * q_rad + 0.5 * arm.inertia_kg_m2 / arm.mgl_nm * v_rad_s**2
        if not least_rad < q_rad < most_rad:
            return False
        for end_rad in (least_rad, most_rad):
            if not 1 - np.cos(end_rad) - share * end_rad + friction * abs(end_rad - q_rad) > energy:
                return False
    return True


def probe_shares(arm: Arm, motion: Motion, joint: dict[str, Any]) -> tuple[float, float] | None:
    """Two constant torques, as shares of the rough `arm`'s gravity, that stay within the joint's limits.

    `motion` is what the joint did until then: the first begins anywhere in it. None: there is no such pair.
    """
    least_rad = max(float(joint["position_min_rad"]) + MARGIN_RAD, -OVER_THE_TOP_RAD)
    most_rad = min(float(joint["position_max_rad"]) - MARGIN_RAD, OVER_THE_TOP_RAD)
    before = list(zip(motion.position_rad[::10], motion.velocity_rad_s[::10], strict=True))
    held = max(arm.coulomb_nm, 0.0) / arm.mgl_nm
    for first, second in PROBES:
        rests = [(float(np.arcsin(np.clip(first + off, -1.0, 1.0))), 0.0) for off in (-held, held)]
        if _stays(arm, first, before, least_rad, most_rad) and _stays(arm, second, rests, least_rad, most_rad):
            return first, second
    return None
