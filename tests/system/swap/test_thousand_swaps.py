# SPDX-License-Identifier: Apache-2.0
"""Alternating swaps at 1 kHz while the arm moves: what a swap costs in ticks, and what it does to the torque."""

import math
import time
from collections.abc import Callable

import numpy as np
import pytest
from calm import calm_robot, connected
from lithe.demo import losses
from lithe.demo.recorder import Recorder
from system.robot_rig import ROOT

pytestmark = pytest.mark.alone

PERIOD_S = 0.03
BEFORE_NS = 5_000_000  # staging: the Loader is at work
AFTER_NS = 6_000_000  # the commit, and the old law is retired
SURE = 1e-4  # a difference this unlikely by chance is none
LAWS = ("pd", "gravity_pd")


@pytest.mark.parametrize("swaps", [300, pytest.param(1000, marks=pytest.mark.long)])
def test_many_swaps_lose_no_tick_and_bound_every_step(tell: Callable[[str], None], swaps: int) -> None:
    """All commit; ticks are lost near a swap no more often than elsewhere; no torque step beats the slew bound."""
    with calm_robot(), connected() as robot:
        sources = [(ROOT / f"laws/{name}.cpp").read_text() for name in LAWS]
        for name, source in zip(LAWS, sources, strict=True):  # compiled once; from here on the cache answers
            robot.swap(source, name=f"{name}.cpp")
        recorder = Recorder("arm")
        commits = []
        for i in range(swaps):
            next_s = time.monotonic() + PERIOD_S
            angle_rad = 0.8 * math.sin(i * PERIOD_S * math.pi)
            robot.publish([time.monotonic_ns() + 50_000_000 * (k + 1) for k in range(4)], [angle_rad] * 4)
            commits.append(robot.swap(sources[i % 2], name=f"{LAWS[i % 2]}.cpp")["commit_tick"])
            time.sleep(max(0.0, next_s - time.monotonic()))
        records = recorder.finish()
        rate_hz = float(robot.spine.info["rate_hz"])
        bound_nm = float(robot.spine.info["torque_slew_nm_s"][0]) / rate_hz

    steps_nm = np.abs(np.diff(records["command_torque_nm"][:, 0]))
    made = losses.releases(records, round(1e9 / rate_hz))
    times_ns = [losses.commit_ns(records, tick) for tick in commits]
    windows = [(time_ns - BEFORE_NS, time_ns + AFTER_NS) for time_ns in times_ns]
    others = losses.elsewhere((windows[0][0], windows[-1][1]), windows, BEFORE_NS + AFTER_NS)
    told = losses.compare(made, windows, others)
    tell(f"{len(set(commits))} swaps committed, {len(np.unique(records['law_id']))} laws ran")
    tell(
        f"{told.at_events} of {told.events} swap windows with a lost tick, elsewhere {told.between} of {told.others}, "
        f"{(BEFORE_NS + AFTER_NS) / 1e6:g} ms each (p = {told.chance:.2g}; {told.would_show(SURE)} would have failed)"
    )
    tell(f"largest torque step {steps_nm.max():.4f} N m, slew bound {bound_nm:.4f} N m")

    assert recorder.lost == 0, "every tick was recorded"
    assert (np.diff(records["tick"].astype(np.int64)) == 1).all()
    assert len(set(commits)) == swaps
    assert told.others > swaps / 2, "there is enough to compare with"
    assert told.chance >= SURE, str(told)
    assert steps_nm.max() <= bound_nm + 1e-9
