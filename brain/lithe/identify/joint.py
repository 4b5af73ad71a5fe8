# SPDX-License-Identifier: Apache-2.0
"""Identifies a joint from telemetry: J q'' + mgl sin(q + q0) + b q' + tau_c sgn q' = tau, with or without gravity.

q0 is by how much the joint's angle 0 is off straight down: an error of the encoder, or of how the robot stands. Left
out, it goes into mgl where a joint swings to one side only: 0.5 degrees at rests of 30 degrees make 1.5 %.

Integrated over short windows (momentum form) the equation needs no acceleration, which quantised encoders do not give:

    integral of tau dt = J [q'] + g_s * integral of sin q dt + g_c * integral of cos q dt + b * [q]
                         + tau_c * integral of sgn q' dt        with g_s = mgl cos q0, g_c = mgl sin q0

Linear in (J, g_s, g_c, b, tau_c), so least squares gives estimates and their standard errors. Windows in which the
joint (nearly) rests are left out: there friction may be anything between -tau_c and +tau_c, and an estimate from rest
alone is off by up to tau_c / (mgl sin q). Windows overlap, which uses each sample better; the standard errors count
them as if only those that do not overlap told anything, so they are on the safe side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Vector = npt.NDArray[np.float64]

OVERLAP = 5  # windows that share a moment
# Less than the 1.96 of independent errors, for the standard errors are on the safe side: they count overlapping windows
# as one. tests/system/agents/test_estimate.py measures how often it holds, and that half of it does not.
INTERVAL_SE = 1.3
SLOPE_S, SLOPE_TICKS = 0.008, 7
LONGEST_GAP_S = 0.02  # ticks that a busy machine skips; the arm moves smoothly through such a gap


@dataclass(frozen=True)
class Motion:
    """Telemetry of one joint, shape (n,) each: time [s], angle [rad], velocity [rad/s], measured torque [N m]."""

    t_s: Vector
    position_rad: Vector
    velocity_rad_s: Vector
    torque_nm: Vector

    def without_repeats(self) -> Motion:
        """Without the samples that a late bus left as they were a tick before."""
        new = np.concatenate(([True], np.diff(self.t_s) > 0))
        return Motion(self.t_s[new], self.position_rad[new], self.velocity_rad_s[new], self.torque_nm[new])


@dataclass(frozen=True)
class Arm:
    """Estimates and their standard errors."""

    mgl_nm: float
    mgl_se_nm: float
    zero_rad: float  # added to a measured angle it is the angle from straight down; 0 without gravity
    inertia_kg_m2: float
    inertia_se_kg_m2: float
    viscous_nm_s_rad: float
    coulomb_nm: float
    coulomb_se_nm: float
    windows: int

    @property
    def mgl_interval_nm(self) -> tuple[float, float]:
        """Least and most [N m] between which mgl lies, with a confidence of 95 %.

        In the torque that the drive tells: what a wrong torque constant does to both cannot be seen from here.
        """
        return self.mgl_nm - INTERVAL_SE * self.mgl_se_nm, self.mgl_nm + INTERVAL_SE * self.mgl_se_nm


def running_integral(values: Vector, t_s: Vector) -> Vector:
    return np.concatenate(([0.0], np.cumsum((values[1:] + values[:-1]) / 2 * np.diff(t_s))))


def velocity(motion: Motion, share: float = 1.0) -> Vector:
    """Slope of the angle over the samples near each one, so without the delay of the drive's own filter.

    Near is within SLOPE_S, or the time of SLOPE_TICKS where ticks are slow (some may be missing on a busy machine);
    of this a `share`, at least a half.
    NaN where there are too few of them: at both ends, and beside gaps.
    """
    t, q = motion.t_s, motion.position_rad
    near_s = share * max(SLOPE_S, SLOPE_TICKS * float(np.median(np.diff(t))) if len(t) > 1 else 0.0)
    first = np.searchsorted(t, t - near_s)
    after = np.searchsorted(t, t + near_s, side="right")
    count = after - first

    def total(values: Vector) -> Vector:
        sums: Vector = np.concatenate(([0.0], np.cumsum(values)))
        return np.asarray(sums[after] - sums[first])

    spread = count * total(t * t) - total(t) ** 2
    enough = (count >= 7) & (t - near_s >= t[0]) & (t + near_s <= t[-1]) & (spread > 0)
    slope = np.full(len(t), np.nan)
    slope[enough] = ((count * total(t * q) - total(t) * total(q))[enough]) / spread[enough]
    return slope


def _rows(motion: Motion, window_s: float, moving_rad_s: float) -> tuple[list[list[float]], list[float]]:
    t, q = motion.t_s, motion.position_rad
    v = velocity(motion)
    sine = running_integral(np.sin(q), t)
    cosine = running_integral(np.cos(q), t)
    impulse = running_integral(motion.torque_nm, t)
    rows, impulses = [], []
    for start_s in np.arange(t[0], t[-1] - window_s, window_s / OVERLAP):
        a, b = np.searchsorted(t, [start_s, start_s + window_s])
        if a == b:
            continue  # all of it lies in a gap
        sign = np.sign(v[a])
        if not np.min(sign * v[a : b + 1]) > moving_rad_s or np.max(np.diff(t[a : b + 1])) > LONGEST_GAP_S:
            continue  # friction without a known sign, or a gap in the record
        rows.append([v[b] - v[a], sine[b] - sine[a], cosine[b] - cosine[a], q[b] - q[a], sign * (t[b] - t[a])])
        impulses.append(impulse[b] - impulse[a])
    return rows, impulses


def _least_squares(a: npt.NDArray[np.float64], y: Vector) -> tuple[Vector, npt.NDArray[np.float64]]:
    """Estimates and their covariance; windows that overlap n-fold count as n times fewer."""
    solution, _, rank, _ = np.linalg.lstsq(a, y, rcond=None)
    if rank < a.shape[1]:
        raise ValueError("the motion does not tell the parameters apart: excite the arm more")
    residual = y - a @ solution
    variance = float(residual @ residual) / max(1.0, len(y) / OVERLAP - a.shape[1])
    covariance = np.asarray(np.linalg.inv(a.T @ a) * variance, dtype=np.float64)
    return np.asarray(solution, dtype=np.float64), covariance


def _all_rows(motions: list[Motion], window_s: float, moving_rad_s: float) -> tuple[npt.NDArray[np.float64], Vector]:
    rows: list[list[float]] = []
    impulses: list[float] = []
    for motion in motions:
        more_rows, more_impulses = _rows(motion.without_repeats(), window_s, moving_rad_s)
        rows += more_rows
        impulses += more_impulses
    if len(rows) < 8 * OVERLAP:
        raise ValueError(f"only {len(rows)} windows with motion: excite the arm more, or record longer")
    return np.array(rows), np.array(impulses)


def _gravity(solution: Vector, covariance: npt.NDArray[np.float64]) -> tuple[float, float, float]:
    """mgl [N m] with its standard error (to first order), and q0 [rad], from g_s and g_c."""
    mgl = float(np.hypot(solution[1], solution[2]))
    if mgl == 0:
        return 0.0, 0.0, 0.0
    along = solution[1:3] / mgl
    error = float(np.sqrt(along @ covariance[1:3, 1:3] @ along))
    if solution[1] < 0:  # it pulls away from straight down: whatever this is, no weight
        return -mgl, error, 0.0
    return mgl, error, float(np.arctan2(solution[2], solution[1]))


def _fit(a: npt.NDArray[np.float64], y: Vector, gravity: bool) -> Arm:
    solution, covariance = np.zeros(5), np.zeros((5, 5))

    def solve(columns: list[int]) -> None:
        solution[columns], covariance[np.ix_(columns, columns)] = _least_squares(a[:, columns], y)

    solve([0, 1, 2, 3, 4] if gravity else [0, 3, 4])
    if solution[3] < 0:  # no arm is driven by its own friction: within the noise there is no viscous part
        solution[3] = covariance[3, :] = covariance[:, 3] = 0.0
        solve([0, 1, 2, 4] if gravity else [0, 4])
    mgl_nm, mgl_se_nm, zero_rad = _gravity(solution, covariance)
    errors = np.sqrt(np.diag(covariance))
    return Arm(
        mgl_nm=mgl_nm,
        mgl_se_nm=mgl_se_nm,
        zero_rad=zero_rad,
        inertia_kg_m2=float(solution[0]),
        inertia_se_kg_m2=float(errors[0]),
        viscous_nm_s_rad=float(solution[3]),
        coulomb_nm=float(solution[4]),
        coulomb_se_nm=float(errors[4]),
        windows=len(y),
    )


def identify_arm(motions: list[Motion], window_s: float = 0.08, moving_rad_s: float = 0.15) -> Arm:
    """Least squares over all windows of all motions. ValueError if the arm moved too little to tell."""
    arm = _fit(*_all_rows(motions, window_s, moving_rad_s), gravity=True)
    if not 0 < 4 * arm.mgl_se_nm < arm.mgl_nm or not arm.inertia_kg_m2 > 0:
        raise ValueError(
            f"mgl = {arm.mgl_nm:.4f} +- {arm.mgl_se_nm:.4f} N m, J = {arm.inertia_kg_m2:.2e} kg m2 says nothing: "
            "excite the arm more"
        )
    return arm


def identify_joint(motions: list[Motion], window_s: float = 0.08, moving_rad_s: float = 0.15) -> Arm:
    """As identify_arm, of a joint that may bear no gravity: then mgl and its error are 0, and no term of it was fitted.

    It bears gravity when the estimate stands clear of its error, and pulls harder than dry friction holds: less than
    that moves no joint, and cannot be told from friction that differs by direction.
    """
    a, y = _all_rows(motions, window_s, moving_rad_s)
    arm = _fit(a, y, gravity=True)
    if not (0 < 4 * arm.mgl_se_nm < arm.mgl_nm and arm.mgl_nm > arm.coulomb_nm):
        arm = _fit(a, y, gravity=False)
    if not 0 < 4 * arm.inertia_se_kg_m2 < arm.inertia_kg_m2:
        raise ValueError(
            f"J = {arm.inertia_kg_m2:.2e} +- {arm.inertia_se_kg_m2:.1e} kg m2 says nothing: excite the joint more"
        )
    return arm


def torque_lag_s(records: list[tuple[Vector, Vector, Vector]], most_s: float = 0.03) -> float:
    """How long after a torque was commanded it is measured: bus, drive and their ticks, all in all.

    It is the shift that makes both alike. A record is time [s], commanded and measured torque [N m]; one in which more
    happens counts for more. Resolution: a quarter of a millisecond. 0 when nothing but constants was commanded.
    """
    lags = np.arange(0.0, most_s, 0.00025)
    apart = np.zeros(len(lags))
    for t_s, command_nm, torque_nm in records:
        new = np.concatenate(([True], np.diff(t_s) > 0))
        t, command, torque = t_s[new], command_nm[new], torque_nm[new]
        seen = t >= t[0] + most_s  # of what was commanded before the record nothing is known
        apart += [float(np.sum((torque[seen] - np.interp(t[seen] - lag, t, command)) ** 2)) for lag in lags]
    return float(lags[int(np.argmin(apart))])


def mgl_at_rest(torques_nm: Vector, angles_rad: Vector, coulomb_nm: float) -> tuple[float, float]:
    """mgl [N m] and its standard error from steady deflections alone: tau = mgl sin q, friction anywhere in its band.

    The error counts friction as uniform in [-coulomb, coulomb]: it, and not noise, limits what rest can tell.
    """
    s = np.sin(angles_rad)
    mgl = float(s @ torques_nm / (s @ s))
    return mgl, float(coulomb_nm / np.sqrt(3.0) / np.sqrt(s @ s))
