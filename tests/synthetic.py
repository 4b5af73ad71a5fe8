# SPDX-License-Identifier: Apache-2.0
"""A made-up recording of the experiment with known answers, for the tests of judge, recorder and figures."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from lithe.demo.judge import PHASES, Story
from lithe.shm import dtype

SECOND_NS = 1_000_000_000
PHASE_NS = 2 * SECOND_NS
SWAP_TICKS = (2_000, 6_000)
LOST = {1_800: 1, 2_010: 2, 11_000: 3}  # before which ticks how many releases were skipped


def records(ticks: int = 14_000) -> npt.NDArray[Any]:
    """Errors of 10 degrees before the second swap and of 1 degree after it; 6 ticks lost.

    Namely 1 while the first law compiles, 2 shortly after its commit, 3 far from any swap.
    """
    made = np.zeros(ticks, dtype("Telemetry"))
    tick = np.arange(ticks)
    made["tick"] = tick
    made["missed_releases"] = sum(count * (tick >= at) for at, count in LOST.items())
    made["release_ns"] = 10**12 + (tick + made["missed_releases"].astype(np.int64)) * 1_000_000
    made["joint_count"] = 1
    made["mode"] = 1
    made["release_jitter_ns"] = 10 + tick % 7
    made["handoff_ns"] = 100 + tick % 50
    made["tick_ns"] = 5_000
    made["brain_age_ns"] = np.where((tick >= 8_000) & (tick < 9_500), (tick - 8_000) * 1_000_000, 10_000_000)
    made["setpoint_position_rad"][:, 0] = np.pi / 2
    made["position_rad"][:, 0] = np.pi / 2 - np.radians(np.where(tick < SWAP_TICKS[1], 10.0, 1.0))
    made["command_torque_nm"][:, 0] = np.where(tick < SWAP_TICKS[0], 0.0, 0.12)
    return made


def story() -> Story:
    """Phases of two seconds each, two swaps, a freeze and a killed Brain."""
    told = Story(estimate={"mgl_hat_nm": 0.16, "mgl_se_nm": 0.001}, source="// law")
    start_ns = 10**12
    for number, name in enumerate(PHASES):
        told.begin(name, start_ns + PHASE_NS * number)
    told.end(start_ns + PHASE_NS * len(PHASES))
    told.freeze_ns = (start_ns + 8 * SECOND_NS, start_ns + 19 * SECOND_NS // 2)
    told.kill_ns = (start_ns + 12 * SECOND_NS, start_ns + 13 * SECOND_NS)
    for law, commit in zip(("probe", "evolved"), SWAP_TICKS, strict=True):
        told.swaps.append(
            {
                "law": law,
                "commit_tick": commit,
                "compile_ms": 300.0,
                "load_ms": 5.0,
                "cached": False,
                "requested_to_committed_ms": 310.0,
                "split_ms": {"queued": 0.5, "compiled": 300.0, "tried": 9.5},
                "sent_ns": start_ns + commit * 1_000_000 - 310_000_000,
            }
        )
    return told


def robot_info() -> npt.NDArray[Any]:
    """What the Spine would say of itself."""
    info = np.zeros((), dtype("RobotInfo"))
    info["rate_hz"] = 1000.0
    info["joint_count"] = 1
    info["torque_slew_nm_s"][0] = 120.0
    return info
