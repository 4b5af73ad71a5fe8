# SPDX-License-Identifier: Apache-2.0
"""1,000 alternating swaps at 1 kHz while the arm moves: what a swap costs in ticks, and what it does to the torque."""

import math
import time
from collections.abc import Callable

import numpy as np
import pytest
from calm import calm_robot, connected
from lithe.demo.recorder import Recorder
from losses import compare
from system.house import BIN, ROOT

SWAPS = 1000
PERIOD_S = 0.03
BEFORE_TICKS = 5  # staging: the Loader is at work
WINDOW_TICKS = 11  # and 5 ticks after the commit: the old law is retired
LAWS = ("pd", "gravity_pd")


def test_a_thousand_swaps_lose_no_tick_and_bound_every_step(
    tell: Callable[[str], None],
) -> None:
    """All commit; ticks are lost near a swap no more often than elsewhere; no torque step beats the slew bound."""
    if not (BIN / "lithe-spine").exists():
        pytest.skip(f"no binaries in {BIN}: make, or set LITHE_BIN_DIR")
    with calm_robot(), connected() as robot:
        sources = [(ROOT / f"laws/{name}.cpp").read_text() for name in LAWS]
        for name, source in zip(LAWS, sources, strict=True):  # compiled once; from here on the cache answers
            robot.swap(source, name=f"{name}.cpp")
        recorder = Recorder("arm")
        commits = []
        for i in range(SWAPS):
            next_s = time.monotonic() + PERIOD_S
            angle_rad = 0.8 * math.sin(i * PERIOD_S * math.pi)
            robot.publish([time.monotonic_ns() + 50_000_000 * (k + 1) for k in range(4)], [angle_rad] * 4)
            commits.append(robot.swap(sources[i % 2], name=f"{LAWS[i % 2]}.cpp")["commit_tick"])
            time.sleep(max(0.0, next_s - time.monotonic()))
        records = recorder.finish()
        bound_nm = float(robot.spine.info["torque_slew_nm_s"][0]) / float(robot.spine.info["rate_hz"])

    steps_nm = np.abs(np.diff(records["command_torque_nm"][:, 0]))
    told = compare(records, np.array(commits, dtype=np.int64) - BEFORE_TICKS, WINDOW_TICKS)
    tell(f"{len(set(commits))} swaps committed, {len(np.unique(records['law_id']))} laws ran")
    tell(f"{told}, {WINDOW_TICKS} ticks each")
    tell(f"largest torque step {steps_nm.max():.4f} N m, slew bound {bound_nm:.4f} N m")

    assert recorder.lost == 0, "every tick was recorded"
    assert (np.diff(records["tick"].astype(np.int64)) == 1).all()
    assert len(set(commits)) == SWAPS
    assert told.events >= SWAPS - 2, "the first and the last may lie at the edge of the record"
    assert told.others > SWAPS / 2, "there is enough to compare with"
    assert not told.costs_ticks, str(told)
    assert steps_nm.max() <= bound_nm + 1e-9
