# SPDX-License-Identifier: Apache-2.0
"""The agent's loop when a law stops the robot that is made up, and when a person or a drive does."""

from typing import Any

import pytest
from fake_robot import FakeRobot, run
from lithe._wire import Mode


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
    inside = ["recover", "activate", "arm"] if fault == "position_limit" else []
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
    [("drive_lost", Mode.safe_stop), ("memory_damaged", Mode.safe_stop), ("estop_pressed", Mode.estop),
     ("none", Mode.disarmed)],
)  # fmt: skip
def test_what_a_person_must_look_at_ends_it_and_no_verb_moves_it_again(fault: str, mode: Mode) -> None:
    robot = FakeRobot()
    result, _, _ = run(robot, [0.3, lambda: robot.stopped(fault, mode), 0.1], growth=1.0)
    assert result.stopped and fault in result.why and "for a person" in result.why and robot.mode == mode
    after = [verb for verb, _ in robot.asked][-6:]
    assert not {"arm", "reset", "recover", "set_reference"} & set(after), after


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
