# SPDX-License-Identifier: Apache-2.0
"""How well the running law follows its setpoint, from telemetry. Threads: pure functions."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from .._wire import Mode, TelemetryFlags
from ..errors import Refused

CLAMPED = (
    TelemetryFlags.torque_clamped | TelemetryFlags.slew_clamped | TelemetryFlags.position_clamped
    | TelemetryFlags.velocity_clamped | TelemetryFlags.power_clamped
)  # fmt: skip


def aligned_error_rad(records: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Setpoint minus position [rad], shape (n, joints), both of the instant of the sample.

    A sample is older than the setpoint of its tick, by about one period; without this a moving joint seems to lag by
    its speed times that age.
    """
    woke_ns = records["release_ns"] + records["release_jitter_ns"].astype(np.int64)
    older_s = np.where(records["sample_ns"] == 0, 0.0, (woke_ns - records["sample_ns"]) * 1e-9)
    setpoint_rad = records["setpoint_position_rad"] - records["setpoint_velocity_rad_s"] * older_s[:, np.newaxis]
    error_rad: npt.NDArray[np.float64] = setpoint_rad - records["position_rad"]
    return error_rad


def measured(records: npt.NDArray[Any], weights: npt.NDArray[np.float64], joints: list[str]) -> dict[str, Any]:
    """The answer of the verb `measure`: only ticks in mode active under the law of the newest record count.

    `weights`: how many ticks a record stands for. Refused: that law does not run.
    """
    if not len(records) or records[-1]["mode"] != Mode.active:
        mode = Mode(int(records[-1]["mode"])).name if len(records) else "unknown"
        raise Refused("not_active", f"no law runs: the robot is in mode {mode}", "status says why, and what leads back")
    counted = (records["mode"] == Mode.active) & (records["law_id"] == records[-1]["law_id"])
    theirs, weights = records[counted], weights[counted]
    error_rad, torque_nm = aligned_error_rad(theirs), theirs["command_torque_nm"]
    mean = weights / weights.sum()
    return {
        "law_id": int(theirs[-1]["law_id"]),
        "seconds": round(float(theirs["release_ns"][-1] - theirs["release_ns"][0]) * 1e-9, 3),
        "ticks": int(weights.sum()),
        "missed_ticks": int(theirs["missed_releases"][-1]) - int(theirs["missed_releases"][0]),
        "clamped_share": round(float(mean @ ((theirs["flags"] & CLAMPED) != 0)), 4),
        "joints": {
            name: {
                "rms_error_rad": float(f"{np.sqrt(mean @ error_rad[:, j] ** 2):.4g}"),
                "median_error_rad": float(f"{np.median(np.abs(error_rad[:, j])):.4g}"),
                "max_error_rad": float(f"{np.abs(error_rad[:, j]).max():.4g}"),
                "rms_torque_nm": float(f"{np.sqrt(mean @ torque_nm[:, j] ** 2):.4g}"),
                "max_torque_nm": float(f"{np.abs(torque_nm[:, j]).max():.4g}"),
            }
            for j, name in enumerate(joints)
        },
    }
