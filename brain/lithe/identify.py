# SPDX-License-Identifier: Apache-2.0
"""Identifies a one-joint arm from telemetry: J q'' + mgl sin q + b q' + tau_c sgn q' = tau.

Integrated over short windows (momentum form) the equation needs no acceleration, which quantised encoders do not give:

    integral of tau dt = J [q'] + mgl * integral of sin q dt + b * [q] + tau_c * integral of sgn q' dt

Linear in (J, mgl, b, tau_c), so least squares gives estimates and their standard errors. Windows in which the joint (nearly)
rests are left out: there friction may be anything between -tau_c and +tau_c, and an estimate from rest alone is off by up to
tau_c / (mgl sin q).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Vector = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """Telemetry of one joint, shape (n,) each: time [s], angle [rad], velocity [rad/s], measured torque [N m]."""

    t_s: Vector
    position_rad: Vector
    velocity_rad_s: Vector
    torque_nm: Vector


@dataclass(frozen=True)
class Arm:
    """Estimates and their standard errors."""

    mgl_nm: float
    mgl_se_nm: float
    inertia_kg_m2: float
    inertia_se_kg_m2: float
    viscous_nm_s_rad: float
    coulomb_nm: float
    coulomb_se_nm: float
    windows: int


def _trapezoid(values: Vector, t_s: Vector) -> float:
    return float(np.sum((values[1:] + values[:-1]) * np.diff(t_s)) / 2)


def _rows(motion: Motion, window_s: float, moving_rad_s: float) -> tuple[list[list[float]], list[float]]:
    step_s = float(np.median(np.diff(motion.t_s)))
    length = max(4, round(window_s / step_s))
    rows, impulses = [], []
    for start in range(0, len(motion.t_s) - length, length):
        part = slice(start, start + length + 1)
        t, q, v = motion.t_s[part], motion.position_rad[part], motion.velocity_rad_s[part]
        if np.any(np.diff(t) > 3 * step_s) or np.min(np.abs(v)) < moving_rad_s:
            continue  # a gap in the record, or friction without a known sign
        rows.append([v[-1] - v[0], _trapezoid(np.sin(q), t), q[-1] - q[0], _trapezoid(np.sign(v), t)])
        impulses.append(_trapezoid(motion.torque_nm[part], t))
    return rows, impulses


def identify_arm(motions: list[Motion], window_s: float = 0.03, moving_rad_s: float = 0.15) -> Arm:
    """Least squares over all windows of all motions. ValueError if the arm hardly moved."""
    rows: list[list[float]] = []
    impulses: list[float] = []
    for motion in motions:
        more_rows, more_impulses = _rows(motion, window_s, moving_rad_s)
        rows += more_rows
        impulses += more_impulses
    if len(rows) < 12:
        raise ValueError(f"only {len(rows)} windows with motion: excite the arm more, or record longer")
    a, y = np.array(rows), np.array(impulses)
    solution, _, rank, _ = np.linalg.lstsq(a, y, rcond=None)
    if rank < a.shape[1]:
        raise ValueError("the motion does not tell the parameters apart: excite the arm more")
    residual = y - a @ solution
    variance = float(residual @ residual) / (len(y) - a.shape[1])
    errors = np.sqrt(np.diag(np.linalg.inv(a.T @ a)) * variance)
    return Arm(
        mgl_nm=float(solution[1]),
        mgl_se_nm=float(errors[1]),
        inertia_kg_m2=float(solution[0]),
        inertia_se_kg_m2=float(errors[0]),
        viscous_nm_s_rad=float(solution[2]),
        coulomb_nm=float(solution[3]),
        coulomb_se_nm=float(errors[3]),
        windows=len(y),
    )


def mgl_at_rest(torques_nm: Vector, angles_rad: Vector, coulomb_nm: float) -> tuple[float, float]:
    """mgl [N m] and its standard error from steady deflections alone: tau = mgl sin q, friction unknown within its band.

    The error counts friction as uniform in [-coulomb, coulomb]: it, and not noise, limits what rest can tell.
    """
    s = np.sin(angles_rad)
    mgl = float(s @ torques_nm / (s @ s))
    return mgl, float(coulomb_nm / np.sqrt(3.0) / np.sqrt(s @ s))
