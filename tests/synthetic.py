# SPDX-License-Identifier: Apache-2.0
"""A made-up recording of the experiment with known answers, for the tests of judge, recorder and figures."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from lithe.demo import judge
from lithe.demo.joints import SimJoint
from lithe.demo.judge import PHASES, Story
from lithe.shm import dtype

SECOND_NS = 1_000_000_000
PHASE_NS = 2 * SECOND_NS
SWAP_TICKS = (2_000, 6_000)
LOST = {1_800: 1, 2_010: 2, 11_000: 3}  # before which ticks how many releases were skipped


SIMS = [SimJoint("shoulder", 0.165), SimJoint("boom", 1.5, 0.99), SimJoint("column", 0.0)]


def records(ticks: int = 14_000, joints: int = 1) -> npt.NDArray[Any]:
    """Errors of 10 degrees before the second swap and of 1 degree after it, of the next joint twice as much, and so on.

    6 ticks are lost: 1 while the first law compiles, 2 shortly after its commit, 3 far from any swap. The torque of
    every joint steps by 0.12 N m at the first swap.
    """
    made = np.zeros(ticks, dtype("Telemetry"))
    tick = np.arange(ticks)
    made["tick"] = tick
    made["missed_releases"] = sum(count * (tick >= at) for at, count in LOST.items())
    made["release_ns"] = 10**12 + (tick + made["missed_releases"].astype(np.int64)) * 1_000_000
    made["joint_count"] = joints
    made["mode"] = 1
    made["release_jitter_ns"] = 10 + tick % 7
    made["handoff_ns"] = 100 + tick % 50
    made["tick_ns"] = 5_000
    made["brain_age_ns"] = np.where((tick >= 8_000) & (tick < 9_500), (tick - 8_000) * 1_000_000, 10_000_000)
    made["setpoint_position_rad"][:, :joints] = np.pi / 2
    for joint in range(joints):
        error_deg = (joint + 1) * np.where(tick < SWAP_TICKS[1], 10.0, 1.0)
        made["position_rad"][:, joint] = np.pi / 2 - np.radians(error_deg)
        made["command_torque_nm"][:, joint] = np.where(tick < SWAP_TICKS[0], 0.0, 0.12)
    return made


def story(joints: int = 1) -> Story:
    """Phases of two seconds each, two swaps, a freeze and a killed Brain."""
    found = (0.16, 1.51, 0.0)
    estimates = [
        {
            "name": SIMS[j].name,
            "mgl_hat_nm": found[j],
            "mgl_se_nm": 0.001,
            "mgl_interval_nm": [0.97 * found[j], 1.03 * found[j]],
        }
        for j in range(joints)
    ]
    told = Story(estimates=estimates, source="// law")
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


def robot_info(joints: int = 1) -> npt.NDArray[Any]:
    """What the Spine would say of itself."""
    info = np.zeros((), dtype("RobotInfo"))
    info["rate_hz"] = 1000.0
    info["joint_count"] = joints
    info["torque_slew_nm_s"][:joints] = [120.0, 1500.0, 2000.0][:joints]
    return info


def summary(joints: int = 1) -> dict[str, Any]:
    """What the judge makes of all that."""
    return judge.summarise(records(joints=joints), story(joints), SIMS[:joints], robot_info(joints), 0)
