# SPDX-License-Identifier: Apache-2.0
"""The agent's loop when a law stops the robot that is made up, and when a person or a drive does."""

from collections.abc import Callable
from typing import Any

import pytest
from fake_robot import MOVING, FakeRobot, Once, run
from lithe._wire import Mode
from lithe.agent.model import ModelError


def moved_after(robot: FakeRobot, since: int) -> list[str]:
    return [verb for verb, _ in robot.asked[since:] if verb in MOVING]


@pytest.mark.parametrize("fault", ["velocity_limit", "position_limit", "law_not_finite", "law_faulted"])
def test_a_law_that_stops_the_robot_is_a_generation_that_failed_and_verbs_bring_it_back(fault: str) -> None:
    robot = FakeRobot()
    robot.stops = {0.15: fault}
    result, model, said = run(robot, [0.3, 0.15, 0.2])
    assert [one.verdict for one in result.tries] == ["confirmed", "confirmed", "stopped", "confirmed"]
    assert [one.kept for one in result.tries] == [True, True, False, True] and not result.stopped
    assert robot.laws[robot.active] == 0.2 and robot.mode == Mode.active and result.stops == 1
    told = model.asked[2][1]["content"]
    for words in ("stopped", fault, "wrist: 19.3 rad/s, allowed 18.8", "less gain"):
        assert words in told, words
    way = [what["verb"] for kind, what in said if kind == "way_back"]
    inside = ["recover", "arm"] if fault == "position_limit" else []
    assert way == ["reset", "activate", "arm", *inside], "what the refusals and the stop say is next"


def test_a_best_law_that_stops_the_robot_later_is_the_best_no_longer() -> None:
    robot = FakeRobot()

    def late() -> None:
        robot.stops = {0.22: "law_faulted"}
        robot.stopped("law_faulted")

    result, _, _ = run(robot, [0.3, 0.22, late, 0.25], growth=1.0)
    assert [one.verdict for one in result.tries] == ["confirmed", "confirmed", "stopped", "stopped", "confirmed"]
    assert [one.kept for one in result.tries] == [True, True, False, False, True]
    assert robot.laws[robot.active] == 0.25 and result.best == 4


def test_a_best_law_that_the_spine_took_back_later_is_the_best_no_longer() -> None:
    robot = FakeRobot()

    def fails_late() -> None:
        robot.active = robot.before.pop()

    result, model, _ = run(robot, [0.3, 0.25, fails_late, 0.28])
    assert result.tries[2].verdict == "taken_back" and result.tries[2].said == "NaN. Next: divide by no 0"
    assert "divide by no 0" in model.asked[-1][1]["content"]
    assert robot.laws[robot.active] == 0.2 and result.best == 3


def test_after_stops_in_a_row_the_best_law_runs_in_the_end() -> None:
    robot = FakeRobot()
    robot.stops = dict.fromkeys((0.11, 0.12, 0.13), "velocity_limit")
    result, model, _ = run(robot, [0.3, 0.11, 0.12, 0.13, 0.1], failures=3)
    assert "3 generations in a row" in result.why and result.stops == 3 and len(model.asked) == 4
    assert robot.laws[robot.active] == 0.3 and robot.mode == Mode.active and not result.stopped


@pytest.mark.parametrize(
    ("fault", "mode"),
    [("drive_fault", Mode.safe_stop), ("drive_lost", Mode.safe_stop), ("memory_damaged", Mode.safe_stop),
     ("recover_failed", Mode.safe_stop), ("estop_pressed", Mode.estop), ("velocity_limit", Mode.disarmed),
     ("none", Mode.disarmed), ("none", Mode.hold)],
)  # fmt: skip
def test_what_a_person_must_look_at_ends_it_and_no_verb_moves_it_again(fault: str, mode: Mode) -> None:
    robot = FakeRobot()
    asked = list[int]()

    def stop() -> None:
        robot.stopped(fault, mode)
        asked.append(len(robot.asked))

    result, _, _ = run(robot, [0.3, stop, 0.1], growth=1.0)
    assert result.stopped and fault in result.why and "for a person" in result.why and robot.mode == mode
    assert moved_after(robot, asked[0]) == []


@pytest.mark.parametrize(
    ("after", "what"),
    [
        ("reset", lambda robot: robot.by_person("disarmed", Mode.disarmed)),
        ("activate", lambda robot: robot.by_person("disarmed", Mode.disarmed)),
        ("activate", lambda robot: robot.stopped("estop_pressed", Mode.estop)),
        ("recover", lambda robot: robot.by_person("disarmed", Mode.disarmed)),
        ("arm", lambda robot: robot.by_person("held", Mode.hold)),
        ("arm", lambda robot: robot.by_person("disarmed", Mode.disarmed)),
        ("arm", lambda robot: robot.stopped("drive_fault")),
        ("arm", lambda robot: robot.stopped("drive_lost")),
        ("recover", lambda robot: robot.stopped("recover_failed")),
        ("reset", lambda robot: robot.stopped("memory_damaged")),
    ],
)
def test_on_the_way_back_nothing_moves_it_after_a_person_or_a_fault_of_a_drive(
    after: str, what: Callable[[FakeRobot], None]
) -> None:
    robot = FakeRobot()
    robot.stops = {0.15: "position_limit"}
    asked = list[int]()

    def meanwhile() -> None:
        what(robot)
        asked.append(len(robot.asked))

    robot.then = {after: meanwhile}
    result, _, _ = run(robot, [0.15, 0.2])
    assert result.stopped and "for a person" in result.why and len(asked) == 1
    assert moved_after(robot, asked[0]) == [] and robot.mode != Mode.active


def test_an_estop_that_a_person_reset_on_the_way_back_ends_it_too() -> None:
    robot = FakeRobot()
    robot.stops = {0.15: "velocity_limit"}

    def stop_and_reset() -> None:
        robot.stopped("estop_pressed", Mode.estop)
        robot.reset()

    robot.then = {"activate": stop_and_reset}
    result, _, _ = run(robot, [0.15, 0.2])
    assert "estop by another client" in result.why and robot.mode == Mode.disarmed


def test_a_recover_that_fails_ends_it() -> None:
    robot = FakeRobot()
    robot.stops, robot.stuck = {0.15: "position_limit"}, True
    result, _, _ = run(robot, [0.15, 0.2])
    verbs = [verb for verb, _ in robot.asked]
    assert result.stopped and "recover_failed" in result.why and moved_after(robot, verbs.index("recover") + 1) == []


@pytest.mark.parametrize("fault", ["velocity_limit", "law_not_finite"])
def test_a_law_that_stops_the_robot_when_it_is_armed_is_armed_once(fault: str) -> None:
    robot = FakeRobot()
    robot.stops = {0.15: "velocity_limit"}
    result, _, _ = run(robot, [0.22, lambda: robot.stops.update({0.2: "law_faulted", 0.22: fault}), 0.25], growth=1.0)
    assert [one.verdict for one in result.tries] == ["confirmed", "stopped", "stopped", "confirmed"]
    assert [verb for verb, _ in robot.asked].count("arm") == 2 and robot.laws[robot.active] == 0.25


def test_a_law_at_the_start_that_stops_the_robot_itself_is_not_armed_again() -> None:
    robot = FakeRobot()
    asked = list[int]()

    def stop() -> None:
        robot.stopped("velocity_limit")
        asked.append(len(robot.asked))

    result, _, _ = run(robot, [stop, 0.2])
    assert result.stopped and "the law at the start stops the robot" in result.why
    assert moved_after(robot, asked[0]) == []


@pytest.mark.parametrize("end", [KeyboardInterrupt(), ModelError("timeout", "no answer", "wait")])
def test_at_its_end_it_does_not_move_a_robot_that_has_stopped(end: BaseException) -> None:
    robot = FakeRobot()
    asked = list[int]()

    def stop() -> None:
        robot.stopped("velocity_limit")
        asked.append(len(robot.asked))
        raise end

    result, _, _ = run(robot, [0.3, stop], growth=1.0)
    assert result.stopped and "velocity_limit" in result.why and robot.mode == Mode.safe_stop
    assert moved_after(robot, asked[0]) == []


@pytest.mark.parametrize("verb", ["arm", "recover"])
@pytest.mark.parametrize("late", [False, True])
def test_what_moves_the_robot_is_sent_once_over_a_connection_that_breaks(verb: str, late: bool) -> None:
    robot = FakeRobot()
    robot.stops = {0.15: "velocity_limit" if verb == "arm" else "position_limit"}
    result, _, said = run(robot, [0.15, 0.2], Once(robot, verb, late))
    assert [what["verb"] for kind, what in said if kind == "way_back"].count(verb) == 1
    assert [asked for asked, _ in robot.asked].count(verb) == (not late)
    assert result.stopped == late and (robot.mode == Mode.active) == (not late)


def test_a_stop_on_the_larger_motion_goes_back_to_the_smaller_one() -> None:
    robot = FakeRobot()
    set_reference = robot.set_reference

    def large(**terms: Any) -> dict[str, Any]:
        told = set_reference(**terms)
        if terms["amplitude_rad"][0] > 0.5:
            robot.stopped("velocity_limit")
        return told

    robot.set_reference = large  # type: ignore[method-assign]
    result, _, _ = run(robot, [0.3, 0.2], share=0.5, growth=2.0)
    assert [one.verdict for one in result.tries] == ["confirmed", "stopped", "confirmed"]
    assert [one.share for one in result.tries] == [0.5, 0.5, 0.5] and result.best == 2
