# SPDX-License-Identifier: Apache-2.0
"""How well the running law follows its setpoint, from telemetry. Threads: pure functions."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from .._wire import Mode, PlanState, TelemetryFlags
from ..errors import Refused

BRAIN_STALE = TelemetryFlags.brain_stale
CHANGED_NM, CHANGED_SHARE = 1e-6, 0.01  # a command that differs more from the law's torque is the guard's
ROUNDING_RAD = 1e-7  # two numbers for one position of an encoder
LEAST_STEPS = 20  # fewer positions do not show that they have a step
CLAMPED = (
    TelemetryFlags.torque_clamped | TelemetryFlags.slew_clamped | TelemetryFlags.position_clamped
    | TelemetryFlags.velocity_clamped | TelemetryFlags.power_clamped
)  # fmt: skip


def sample_age_s(records: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """How much older a tick's sample is than its setpoint [s], shape (n,); 0: there is no sample."""
    woke_ns = records["release_ns"] + records["release_jitter_ns"].astype(np.int64)
    age_s: npt.NDArray[np.float64] = np.where(records["sample_ns"] == 0, 0.0, (woke_ns - records["sample_ns"]) * 1e-9)
    return age_s


def aligned_error_rad(records: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Setpoint minus position [rad], shape (n, joints), both of the instant of the sample.

    A sample is older than the setpoint of its tick, by about one period; without this a moving joint seems to lag by
    its speed times that age.
    """
    older_s = sample_age_s(records)
    setpoint_rad = records["setpoint_position_rad"] - records["setpoint_velocity_rad_s"] * older_s[:, np.newaxis]
    error_rad: npt.NDArray[np.float64] = setpoint_rad - records["position_rad"]
    return error_rad


def _clamped(records: npt.NDArray[Any], mean: npt.NDArray[np.float64], joint: int) -> dict[str, Any]:
    """In which share of the ticks the guard changed this joint's torque, and the flags of those ticks; {}: in none.

    A stiffness in the drive (kp) makes both torques differ a little, too: counted only in ticks with such a flag.
    """
    flags, law_nm = records["flags"] & CLAMPED, records["law_torque_nm"][:, joint]
    apart_nm = np.abs(records["command_torque_nm"][:, joint] - law_nm)
    changed = (flags != 0) & (apart_nm > CHANGED_NM + CHANGED_SHARE * np.abs(law_nm))
    if not changed.any():
        return {}
    seen = TelemetryFlags(int(np.bitwise_or.reduce(flags[changed])))
    return {"clamped_share": round(float(mean @ changed), 5), "clamped_by": [str(each.name) for each in seen]}


def _setpoint(records: npt.NDArray[Any], counted: npt.NDArray[np.bool_]) -> dict[str, Any]:
    """For how long no plan was followed, and what that means for the errors; {}: always one was."""
    rests = counted & ((records["plan_state"] != PlanState.track) | ((records["flags"] & BRAIN_STALE) != 0))
    lasts_s = np.diff(records["release_ns"], prepend=records["release_ns"][:1]) * 1e-9
    rested_s = float(lasts_s[rests].sum())
    if not rests.any():
        return {}
    silent_s = float(records["brain_age_ns"][rests].max()) * 1e-9
    stale = bool(((records["flags"][rests] & BRAIN_STALE) != 0).any())
    cause = f"its sender was silent for up to {silent_s:.2g} s" if stale else "no plan was there"
    words = (
        f"for {rested_s:.3g} s the setpoint slowed down or stood still ({cause}): the errors are not the reference's"
    )
    return {"setpoint_rested_s": round(rested_s, 3), "warning": words}


def position_step_rad(position_rad: npt.NDArray[np.float64]) -> float | None:
    """The step of the encoder [rad], shape (n,) of positions: that of which all differences are multiples.

    None: it is finer than what these positions show. Of errors that are spread evenly over a step, the rms is the step
    divided by the square root of 12: no law comes below.
    """
    apart_rad = np.diff(np.unique(position_rad))
    apart_rad = apart_rad[apart_rad > ROUNDING_RAD]
    if len(apart_rad) < LEAST_STEPS:
        return None
    steps = apart_rad / apart_rad.min()
    least = apart_rad[steps < 1.5].mean()  # of several: each is rounded
    steps = apart_rad / least
    whole = np.abs(steps - np.round(steps)) < 0.1
    # Positions at random are apart by whole multiples of their smallest distance in a fifth of the cases only.
    return float(least) if whole.mean() > 0.95 and (np.round(steps) <= 3).mean() > 0.5 else None


def _encoder(position_rad: npt.NDArray[np.float64]) -> dict[str, float]:
    step_rad = position_step_rad(position_rad)
    if step_rad is None:
        return {}
    return {"position_step_rad": float(f"{step_rad:.3g}"), "least_rms_error_rad": float(f"{step_rad / 12**0.5:.3g}")}


def measured(records: npt.NDArray[Any], weights: npt.NDArray[np.float64], joints: list[str]) -> dict[str, Any]:
    """The answer of the verb `measure`: only ticks in mode active under the law of the newest record count.

    `weights`: how many ticks a record stands for. Refused: no law runs, or it holds.
    """
    if not len(records) or records[-1]["mode"] != Mode.active:
        mode = Mode(int(records[-1]["mode"])).name if len(records) else "unknown"
        if mode == Mode.hold.name:
            words = "in mode hold the law runs, but its setpoint rests: there is no motion to measure"
            raise Refused("not_active", words, "arm leads back to mode active, where a reference is followed")
        raise Refused("not_active", f"no law runs: the robot is in mode {mode}", "status says why, and what leads back")
    counted = (records["mode"] == Mode.active) & (records["law_id"] == records[-1]["law_id"])
    theirs, weights = records[counted], weights[counted]
    error_rad, torque_nm = aligned_error_rad(theirs), theirs["command_torque_nm"]
    mean = weights / weights.sum()
    return {
        "law_id": int(theirs[-1]["law_id"]),
        "seconds": round(float(theirs["release_ns"][-1] - theirs["release_ns"][0]) * 1e-9, 3),
        "ticks": int(weights.sum()),
        "from_tick": int(theirs[0]["tick"]),
        "missed_ticks": int(theirs["missed_releases"][-1]) - int(theirs["missed_releases"][0]),
        "clamped_share": round(float(mean @ ((theirs["flags"] & CLAMPED) != 0)), 4),
        **_setpoint(records, counted),
        "joints": {
            name: {
                "rms_error_rad": float(f"{np.sqrt(mean @ error_rad[:, j] ** 2):.3g}"),
                "median_error_rad": float(f"{np.median(np.abs(error_rad[:, j])):.3g}"),
                "max_error_rad": float(f"{np.abs(error_rad[:, j]).max():.3g}"),
                "max_error_tick": int(theirs["tick"][np.abs(error_rad[:, j]).argmax()]),
                "rms_torque_nm": float(f"{np.sqrt(mean @ torque_nm[:, j] ** 2):.3g}"),
                "max_torque_nm": float(f"{np.abs(torque_nm[:, j]).max():.3g}"),
                **_encoder(theirs["position_rad"][:, j]),
                **_clamped(theirs, mean, j),
            }
            for j, name in enumerate(joints)
        },
    }
