# SPDX-License-Identifier: Apache-2.0
"""A law that was admitted and tried pushes with all it has: the joint stays inside its limits. Robots start softly."""

import re

import numpy as np
import pytest
from calm import calm_robot, connected
from lithe._wire import Mode, TelemetryFlags
from lithe.shm import RingCursor
from system.robot_rig import ROOT

LAW = (ROOT / "tests/laws_hostile/full_torque_delayed.cpp").read_text()
LIMIT_RAD = 3.0
TICKS = 7000  # from the commit on: three thousand as a good law, then it pushes


@pytest.mark.alone  # a Spine that is held up for ten ticks cannot brake meanwhile
def test_a_joint_under_full_torque_stays_inside_its_limits() -> None:
    """The law pushes for four seconds, without a probation or a watch that would take it away."""
    with calm_robot(changes={'watch = "last_good"': 'watch = "alarm"'}, ideal=False) as rig, connected() as robot:
        cursor = RingCursor(robot.spine.mapping, "telemetry")
        done = robot.swap(LAW.replace("20'000", "3'000"), name="full_torque.cpp", probation_s=0)
        assert done["commit_tick"] > 0
        positions: list[float] = []
        speeds: list[float] = []

        def pushed() -> bool:
            records = cursor.drain()
            positions.extend(records["position_rad"][:, 0])
            speeds.extend(records["velocity_rad_s"][:, 0])
            return len(records) > 0 and int(records["tick"][-1]) > done["commit_tick"] + TICKS

        rig.wait_for(pushed)
        status = rig.ask("status")
        farthest = float(np.max(np.abs(positions)))
        print(f"farthest {farthest:.4f} rad, fastest {np.max(np.abs(speeds)):.2f} rad/s, mode {status['mode']}")
        assert farthest > 0.9 * LIMIT_RAD, "it did push"
        assert farthest <= LIMIT_RAD
        assert status["mode"] == "active"


def test_a_robot_file_without_soft_start_s_starts_softly_for_the_time_that_is_documented() -> None:
    """Counted in ticks of a running robot, from arming on."""
    page = (ROOT / "docs/hardware.md").read_text(encoding="utf-8")
    (default_s,) = re.findall(r"\| `soft_start_s` \|.*?\(default ([0-9.]+)", page)
    with calm_robot(changes={"soft_start_s = 0.5 ": "# no soft_start_s "}) as rig, connected() as robot:
        rig.ask("disarm")
        cursor = RingCursor(robot.spine.mapping, "telemetry")
        rig.ask("arm")
        soft: list[bool] = []

        def is_over() -> bool:
            records = cursor.drain()
            driven = records["flags"][records["mode"] == Mode.active]
            soft.extend(driven & TelemetryFlags.soft_starting != 0)
            return any(soft) and not soft[-1]

        rig.wait_for(is_over)
    print(f"soft for {sum(soft)} ticks of a millisecond")
    assert abs(sum(soft) - 1000 * float(default_s)) <= 2
