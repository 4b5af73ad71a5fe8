# SPDX-License-Identifier: Apache-2.0
"""References without a robot: their shapes, their limits, who they belong to."""

import math
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from lithe._wire import Mode
from lithe.errors import NotRunning, Refused
from lithe.gateway import references
from lithe.gateway.curves import KINDS
from lithe.gateway.references import MOST_REFUSED, References

CHIRP: dict[str, Any] = {
    "kind": "chirp",
    "centre_rad": 0,
    "amplitude_rad": 0.1,
    "from_hz": 0.1,
    "to_hz": 1,
    "duration_s": 5,
}
STEPS: dict[str, Any] = {"kind": "steps", "rise_s": 0.2}
SINE: dict[str, Any] = {"kind": "sine", "centre_rad": 0.1, "amplitude_rad": [0.5, 0.3], "frequency_hz": 0.5}
GOOD: list[dict[str, Any]] = [
    SINE,
    {"kind": "multisine", "centre_rad": 0, "amplitude_rad": [0.3, 0.3], "frequency_hz": [0.5, 1, 2]},
    {"kind": "chirp", "centre_rad": 0, "amplitude_rad": 0.2, "from_hz": 0.2, "to_hz": 2, "duration_s": 6},
    {"kind": "steps", "position_rad": [[0, 0], [0.5, 0.5], [-0.5, 1]], "every_s": 1, "rise_s": 0.8},
    {"kind": "waypoints", "t_s": [0, 1, 2], "position_rad": [[0, 0], [0.5, 0.5], [-0.5, 1]]},
]


class FakeSpine:
    """Two joints; the setpoint moves."""

    joint_count = 2
    joint_names = ("hip", "knee")

    def __init__(self) -> None:
        self.info = {
            "position_min_rad": np.array([-1.0, -2.0]),
            "position_max_rad": np.array([1.0, 2.0]),
            "velocity_max_rad_s": np.array([3.0, 6.0]),
        }
        self.mode = Mode.active

    def latest(self) -> dict[str, Any]:
        return {
            "mode": int(self.mode),
            "position_rad": np.array([0.11, -0.2]),
            "setpoint_position_rad": np.array([0.1, -0.2]),
            "setpoint_velocity_rad_s": np.array([0.5, -1.0]),
        }


class FakeRobot:
    """Keeps what was published."""

    def __init__(self) -> None:
        self.spine = FakeSpine()
        self.plans: list[tuple[list[int], Any]] = []
        self.came = threading.Event()
        self.gone = False
        self.refusal: Refused | None = None  # of the plans that the main thread publishes
        self.later: Refused | None = None  # of the plans that stream a reference
        self.refused: dict[int, Refused] = {}

    def publish(self, times: list[int], angles: Any) -> int:
        if self.gone:
            raise NotRunning("robot 'fake' has ended")
        self.plans.append((times, angles))
        self.came.set()
        why = self.refusal if threading.current_thread() is threading.main_thread() else self.later
        if why is not None:
            self.refused[len(self.plans)] = why
        return len(self.plans)

    def decided(self, plan_id: int) -> bool:
        assert 0 < plan_id <= len(self.plans)
        if plan_id in self.refused:
            raise self.refused[plan_id]
        return True


@pytest.fixture
def robot() -> FakeRobot:
    return FakeRobot()


def until(condition: Any) -> None:
    """A generous time-out: threads get no time on a busy machine."""
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.parametrize("asked", GOOD, ids=[each["kind"] for each in GOOD])
def test_each_kind_starts_where_the_setpoint_is_and_as_fast_and_keeps_the_limits(
    robot: FakeRobot, asked: dict[str, Any]
) -> None:
    """The first points go on with position and speed; none leaves a limit."""
    kept = References(robot)  # type: ignore[arg-type]
    told = kept.set(asked)
    assert told["asked"] == asked and told["streams"]
    assert robot.came.wait(60)
    made = kept._now
    assert made is not None
    first = made.after(np.array([0.0, 0.001]))
    assert first[0] == pytest.approx([0.1, -0.2])
    assert (first[1] - first[0]) / 0.001 == pytest.approx([0.5, -1.0], abs=0.02)
    angles = made.after(np.arange(0.0, 20.0, 0.01))
    assert (np.abs(angles) <= [1.0, 2.0]).all()
    assert (np.abs(np.diff(angles, axis=0)) / 0.01 <= [3.0, 6.0]).all()
    times, plan = robot.plans[0]
    assert len(times) == references.POINTS and plan.shape == (references.POINTS, 2)


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        ({"kind": "circle"}, "usage", "no reference of kind 'circle'"),
        ({"centre_rad": 0.8}, "refused_limit", "joint 'hip' would be at 1."),
        ({"frequency_hz": 2.5}, "refused_limit", "joint 'hip' would move at"),
        ({"frequency_hz": 20}, "usage", "at most 5 Hz"),
        ({"frequency_hz": -1}, "usage", "above 0"),
        ({"frequency_hz": [0.5, 20]}, "usage", "at most 5 Hz"),
        ({"frequency_hz": [0.5, 1, 2]}, "usage", "one for each of 2 joints"),
        ({"frequency_hz": [0.1, 2.5], "amplitude_rad": 0.5}, "refused_limit", "joint 'knee' would move at 7."),
        ({"ramp_s": [1, 2]}, "usage", "one number from 0.1 to 60"),
        (
            {"frequency_hz": 0.001, "amplitude_rad": [0.5, 3.0]},
            "refused_limit",
            "'knee' would be at 2.154 rad after 120.01",
        ),
        ({"frequency_hz": None}, "usage", "needs 'frequency_hz'"),
        ({"centre_rad": None, "frequency_hz": None}, "usage", "needs 'centre_rad' and 'frequency_hz'"),
        ({"frequency_hz": 9}, "usage", "'frequency_hz' is 9 "),
        ({"to_hz": 1, "from_hz": 1}, "usage", "has no argument 'from_hz' and 'to_hz'"),
        ({"amplitude_rad": [1, 2, 3]}, "usage", "one for each of 2 joints"),
        ({"amplitude_rad": math.nan}, "usage", "not finite"),
        ({"amplitude_rad": "much"}, "usage", "not made of numbers"),
        ({"ramp_s": -1}, "usage", "from 0.1 to 60"),
        ({"from_hz": 1}, "usage", "has no argument 'from_hz'"),
        ({"kind": "waypoints", "t_s": list(range(100000)), "position_rad": [[0, 0]]}, "usage", "1 to 1000"),
        ({**CHIRP, "to_hz": [1, 2]}, "usage", "one number from 0 to 5"),
        ({**CHIRP, "to_hz": 5, "duration_s": 600, "amplitude_rad": 0.2}, "refused_limit", "'hip' would move at"),
        ({**STEPS, "position_rad": [[0, 0]] * 9 + [[0.9, 0]], "every_s": 10}, "refused_limit", "after 90."),
        ({**STEPS, "position_rad": [[0, 0]] * 100, "every_s": 60}, "usage", "at most 3600 s"),
        (
            {"kind": "waypoints", "t_s": [0, 200, 200.2], "position_rad": [[0, 0], [0, 0], [0.9, 0]]},
            "refused_limit",
            "'hip' would move at 6.7",
        ),
        ({"kind": "waypoints", "t_s": [0, 5000], "position_rad": [[0, 0], [0, 0]]}, "usage", "at most 3600 s"),
        (
            {"kind": "multisine", "centre_rad": 0, "amplitude_rad": [0.3, 4], "frequency_hz": [0.01, 0.011]},
            "refused_limit",
            "'knee' would be at",
        ),
        ({"kind": "waypoints", "t_s": [1, 1], "position_rad": [[0, 0], [0, 0]]}, "usage", "ascending"),
        ({"kind": "waypoints", "t_s": [0, 9], "position_rad": [[0, 0]]}, "usage", "2 rows of 2 numbers"),
        ({"kind": "steps", "position_rad": [[0, 0]], "every_s": 0.2, "rise_s": 1}, "usage", "longer than every_s"),
    ],
)
def test_what_cannot_be_is_refused_by_name_and_nothing_changes(
    robot: FakeRobot, change: dict[str, Any], code: str, words: str
) -> None:
    """Joint, value and limit; or the argument and what it takes."""
    asked = {**(SINE if "kind" not in change else {}), **change}
    kept = References(robot)  # type: ignore[arg-type]
    with pytest.raises(Refused) as caught:
        kept.set(asked)
    assert caught.value.code == code
    assert words in f"{caught.value.message} {caught.value.next}"
    assert kept.told()["streams"] is False and not robot.plans


def test_it_ends_when_its_client_leaves_or_is_silent_and_not_when_another_does(robot: FakeRobot) -> None:
    """At rest within COAST_S of the end, and it says why."""
    kept, mine, other = References(robot), object(), object()  # type: ignore[arg-type]
    kept.set(SINE, mine)
    kept.left(other)
    assert kept.told()["asked"]["kind"] == "sine"
    kept.left(mine)
    assert kept.told()["asked"]["kind"] == "rest" and kept.told()["ended"] == "its client has left"
    made = kept._now
    assert made is not None
    late = made.after(np.array([references.COAST_S, references.COAST_S + 1.0]))
    assert late[0] == pytest.approx(late[1]), "it rests"

    kept.set({**SINE, "client_stale_s": 0.2}, mine)
    until(lambda: kept.told()["asked"]["kind"] == "rest")
    assert "silent" in kept.told()["ended"]

    kept.set({**SINE, "stay": True, "client_stale_s": 0.1}, mine)
    kept.left(mine)
    assert kept.told()["asked"]["kind"] == "sine", "told to stay"
    assert kept.stop()["ended"] == "stopped"
    until(lambda: not kept.told()["streams"])


def test_it_says_how_often_and_how_long_its_points_came_too_late(
    robot: FakeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The thread that sends them gets no time for longer than the points last."""
    kept = References(robot)  # type: ignore[arg-type]
    kept.set({**SINE, "stay": True})
    with kept._publishing:  # on a busy machine there may be more of them
        before, until_ns = kept.told(), kept._until_ns
        time.sleep(1e-9 * references.PERIOD_NS * references.POINTS + 0.3)
    until(lambda: kept._until_ns > until_ns)
    told = kept.told()
    assert told["interruptions"] > before["interruptions"] and told["lost_s"] >= before["lost_s"] + 0.3
    told = kept.set({**SINE, "stay": True})
    assert told["interruptions"] == 0 and told["lost_s"] == 0.0, "of the reference before"


def test_a_robot_that_ends_ends_the_reference(robot: FakeRobot) -> None:
    """The thread goes on, and serves the next one."""
    kept = References(robot)  # type: ignore[arg-type]
    kept.set({**SINE, "stay": True})
    until(lambda: robot.plans)
    robot.gone = True
    until(lambda: not kept.told()["streams"])
    assert "has ended" in kept.told()["ended"]
    robot.gone = False
    count = len(robot.plans)
    kept.set({**SINE, "stay": True})
    until(lambda: len(robot.plans) > count)


def test_each_joint_has_its_own_frequency(robot: FakeRobot) -> None:
    """A list of frequencies of a sine is not cut to its first."""
    kept = References(robot)  # type: ignore[arg-type]
    kept.set({"kind": "sine", "centre_rad": 0, "amplitude_rad": 0.5, "frequency_hz": [0.5, 1.0]})
    made = kept._now
    assert made is not None and made.curve is not None
    t_s = 30 + np.arange(0.0, 2.0, 0.01)
    assert made.after(t_s) == pytest.approx(np.column_stack([0.5 * np.sin(k * np.pi * t_s) for k in (1, 2)]), abs=1e-9)
    assert made.curve.whole_s == 2.0


def test_a_multisine_is_checked_over_its_whole_period(robot: FakeRobot) -> None:
    """Two frequencies that meet every 500 s: their peak is far lower in the first minute."""
    kept = References(robot)  # type: ignore[arg-type]
    asked = {"kind": "multisine", "centre_rad": 0, "frequency_hz": [0.25, 0.252]}
    wave = references.curve_of({**asked, "amplitude_rad": 1.0}, 2)
    assert wave.whole_s == pytest.approx(500.0)
    peak = np.abs(wave(np.arange(0.0, 500.0, 0.005)))[:, 1]
    most, soon = peak.max(), peak[: int(60 / 0.005)].max()
    assert soon < 0.8 * most, "it tells something"
    kept.set({**asked, "amplitude_rad": [0.5, 1.99 / most]})
    with pytest.raises(Refused, match="'knee' would be at"):
        kept.set({**asked, "amplitude_rad": [0.5, 1.95 / soon]})


def test_what_the_spine_does_not_follow_is_refused_and_the_one_before_goes_on(robot: FakeRobot) -> None:
    kept = References(robot)  # type: ignore[arg-type]
    kept.set({**SINE, "stay": True})
    before = kept.told()
    robot.refusal = Refused("refused_plan", "the Spine refused the plan: time in the past")
    with pytest.raises(Refused, match="time in the past"):
        kept.set({**SINE, "frequency_hz": 0.25})
    assert kept.told() == before


def test_it_goes_on_after_plans_that_came_too_late_and_ends_after_others(robot: FakeRobot) -> None:
    references = References(robot)  # type: ignore[arg-type]
    robot.later = Refused("refused_plan", "the Spine refused the plan: too_old", "")
    references.set({"kind": "sine", "centre_rad": 0.0, "amplitude_rad": 0.1, "frequency_hz": 0.5, "stay": True})
    count = len(robot.plans)
    wait_until(lambda: len(robot.plans) > count + 3 * MOST_REFUSED)
    assert references.told()["streams"] and references.told()["ended"] == ""
    robot.later = Refused("refused_plan", "the Spine refused the plan: velocity_limit", "")
    wait_until(lambda: references.told()["ended"] != "")
    assert "velocity_limit" in references.told()["ended"]


def wait_until(done: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 60
    while not done():
        assert time.monotonic() < end_s
        time.sleep(0.01)


def test_every_kind_of_the_table_is_offered() -> None:
    """The verb's schema names them all."""
    from lithe.vocabulary import BY_NAME

    kinds = BY_NAME["set_reference"].args["kind"]["enum"]
    assert sorted(kinds) == sorted(["rest", *KINDS])
