# SPDX-License-Identifier: Apache-2.0
"""The sign of life: without it the Spine stops a plan half way, and nobody has to think of it."""

import itertools
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import lithe
import pytest
from lithe._wire import TelemetryFlags
from lithe.heartbeat import LONGEST_S, SHORTEST_S, Heartbeat, period_s
from lithe.shm import SpineView
from system.robot_rig import RobotRig

PLAN_S = 4.0  # twice what the calm robot waits for a sign of life
GOAL_RAD = 0.5


@contextmanager
def brain(heartbeat: bool) -> Iterator[lithe.Robot]:
    """A connection, while this process keeps its cores."""
    cores = os.sched_getaffinity(0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # numpy came before lithe in this process
        robot = lithe.connect("arm", heartbeat=heartbeat)
    try:
        yield robot
    finally:
        robot.close()
        os.sched_setaffinity(0, cores)


def setpoint_rad(robot: lithe.Robot) -> float:
    record = robot.telemetry.latest()
    assert record is not None
    return float(record["setpoint_position_rad"][0])


def is_stale(robot: lithe.Robot) -> bool:
    record = robot.telemetry.latest()
    assert record is not None
    return bool(int(record["flags"]) & TelemetryFlags.brain_stale)


def start_from_zero(robot: lithe.Robot) -> None:
    robot.go_to([0.0], in_s=0.3)
    RobotRig.wait_for(lambda: abs(setpoint_rad(robot)) < 1e-3)


def test_a_long_plan_ends_where_it_should_though_nobody_beats(rig: RobotRig) -> None:
    with brain(heartbeat=True) as robot:
        start_from_zero(robot)
        robot.go_to([GOAL_RAD], in_s=PLAN_S)
        time.sleep(PLAN_S)
        RobotRig.wait_for(lambda: setpoint_rad(robot) == pytest.approx(GOAL_RAD, abs=1e-3))
        assert not is_stale(robot)


def test_a_brain_that_should_beat_itself_and_does_not_is_stopped_on_its_way(rig: RobotRig) -> None:
    with brain(heartbeat=False) as robot:
        start_from_zero(robot)
        robot.go_to([GOAL_RAD], in_s=PLAN_S)
        time.sleep(PLAN_S)
        RobotRig.wait_for(lambda: is_stale(robot))
        assert 0 < setpoint_rad(robot) < GOAL_RAD - 0.05

        def heard() -> bool:
            robot.beat()  # each time: on a busy machine one alone may be stale again before anybody looks
            return not is_stale(robot)

        RobotRig.wait_for(heard)


def test_a_frozen_brain_falls_silent_though_a_thread_beats_for_it(rig: RobotRig) -> None:
    code = "import lithe; r = lithe.connect('arm'); print(1, flush=True); input()"
    env = rig.env | {"PYTHONPATH": str(Path(lithe.__file__).parents[1])}
    with subprocess.Popen([sys.executable, "-c", code], stdin=-1, stdout=-1, env=env) as other:
        try:
            assert other.stdout is not None and other.stdout.readline() == b"1\n"
            view = SpineView("arm")

            def age_s() -> float:
                record = view.latest()
                assert record is not None
                return float(record["brain_age_ns"]) * 1e-9

            ages_s = [age_s()]

            def beats() -> int:
                ages_s.append(age_s())
                return sum(later < earlier for earlier, later in itertools.pairwise(ages_s))

            RobotRig.wait_for(lambda: beats() >= 3)  # it beats all by itself
            other.send_signal(signal.SIGSTOP)
            RobotRig.wait_for(lambda: age_s() > 1.0)
        finally:
            other.kill()


def test_close_ends_the_heartbeat_before_the_next_brain_comes(rig: RobotRig) -> None:
    with brain(heartbeat=True) as robot:
        assert "lithe-heartbeat" in [thread.name for thread in threading.enumerate()]
        robot.close()
        assert "lithe-heartbeat" not in [thread.name for thread in threading.enumerate()]
        with pytest.raises(lithe.NotRunning):
            robot.go_to([0.0], in_s=1.0)
        with pytest.raises(lithe.LitheError, match="closed"):
            robot.status()


@pytest.mark.parametrize(
    ("text", "expected_s"),
    [
        ("[brain]\nstale_after_s = 0.1\n", 0.02),
        ("[brain]\nstale_after_s = 3600\n", LONGEST_S),
        ("[brain]\nstale_after_s = 0\n", SHORTEST_S),
        ("[robot]\nname = 'arm'\n", 0.02),
        ("[brain]\nstale_after_s = 'soon'\n", 0.02),
        ("not toml", 0.02),
        (None, 0.02),
    ],
)
def test_the_period_is_a_fifth_of_what_the_robot_waits(tmp_path: Path, text: str | None, expected_s: float) -> None:
    path = tmp_path / "robot.toml"
    if text is not None:
        path.write_text(text)
    assert period_s(path) == pytest.approx(expected_s)


def test_it_beats_until_it_is_stopped() -> None:
    beats: list[int] = []
    third = threading.Event()

    def beat() -> None:
        beats.append(1)
        if len(beats) == 3:
            third.set()

    heartbeat = Heartbeat(beat, 0.001)
    assert third.wait(30)
    heartbeat.stop()
    count = len(beats)
    time.sleep(0.05)
    assert len(beats) == count
