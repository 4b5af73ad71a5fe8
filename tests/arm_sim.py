# SPDX-License-Identifier: Apache-2.0
"""A one-joint arm and its drive in plain Python.

A plant for tests: gravity, friction that sticks, a lagging torque, whole encoder counts, a velocity filter. Written
from the equations and not from the C++ plant, so that both must be right.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from lithe.identify import Motion

Law = Callable[[float, float, float], float]  # torque [N m] of time [s], angle [rad], velocity [rad/s]


@dataclass
class SimArm:
    """State and parameters; `run` moves it on under a law that ticks each millisecond, one tick late as the Spine."""

    mgl_nm: float = 0.2
    inertia_kg_m2: float = 3.0e-3
    viscous_nm_s_rad: float = 2.0e-4
    coulomb_nm: float = 0.016
    torque_lag_s: float = 0.0012
    encoder_counts: int = 16384
    filter_hz: float = 200.0
    angle_rad: float = 0.0
    velocity_rad_s: float = 0.0
    torque_nm: float = 0.0
    tracked_rad: float = 0.0
    tracked_rad_s: float = 0.0
    t_s: float = 0.0
    late_nm: float = 0.0

    def run(self, law: Law, seconds: float, torque_noise_nm: float = 0.0, seed: int = 0) -> Motion:
        """Telemetry of `seconds` under `law`, one row a tick."""
        rng = np.random.default_rng(seed)
        rows = []
        start_s = self.t_s
        for _ in range(round(seconds * 1000)):
            measured_rad = self._encoder_rad()
            rows.append((self.t_s - start_s, measured_rad, self.tracked_rad_s, self.torque_nm))
            wanted_nm, self.late_nm = self.late_nm, law(self.t_s - start_s, measured_rad, self.tracked_rad_s)
            for _ in range(20):
                self._step(wanted_nm, 5e-5)
        columns = np.array(rows).T
        return Motion(columns[0], columns[1], columns[2], columns[3] + torque_noise_nm * rng.standard_normal(len(rows)))

    def _encoder_rad(self) -> float:
        count_rad = 2 * math.pi / self.encoder_counts
        return math.floor(self.angle_rad / count_rad) * count_rad

    def _step(self, wanted_nm: float, h_s: float) -> None:
        self.torque_nm += (wanted_nm - self.torque_nm) * (1 - math.exp(-h_s / self.torque_lag_s))
        load_nm = self.torque_nm - self.mgl_nm * math.sin(self.angle_rad) - self.viscous_nm_s_rad * self.velocity_rad_s
        if self.velocity_rad_s != 0 or abs(load_nm) > self.coulomb_nm:
            direction = self.velocity_rad_s if self.velocity_rad_s != 0 else load_nm
            before = self.velocity_rad_s
            self.velocity_rad_s += h_s / self.inertia_kg_m2 * (load_nm - math.copysign(self.coulomb_nm, direction))
            if before * self.velocity_rad_s < 0:
                self.velocity_rad_s = 0.0
            self.angle_rad += h_s * self.velocity_rad_s
        pole = 2 * math.pi * self.filter_hz
        error_rad = self._encoder_rad() - self.tracked_rad
        self.tracked_rad_s += h_s * pole * pole * error_rad
        self.tracked_rad += h_s * (self.tracked_rad_s + 2 * pole * error_rad)
        self.t_s += h_s
