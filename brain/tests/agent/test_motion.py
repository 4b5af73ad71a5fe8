# SPDX-License-Identifier: Apache-2.0
"""The motion on which the agent compares laws, the goal, and the scores."""

import argparse
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from fake_robot import JOINT, FakeModel, FakeRobot, run, streamer
from lithe.agent.link import Link
from lithe.agent.options import motion_options
from lithe.agent.reference import MOST_GROWTH, Asked, Streamer, grown, reference_of
from lithe.agent.rounds import Limits, Rounds
from lithe.agent.score import SCORES, Measured, better
from lithe.errors import LitheError


def test_the_amplitude_grows_by_a_bound_and_only_after_a_better_law() -> None:
    robot = FakeRobot()
    result, _, _ = run(robot, [0.3, 0.35, 0.2, 0.1, 0.05], share=0.2, growth=50.0)
    assert [one.share for one in result.tries] == pytest.approx([0.2, 0.4, 0.4, 0.8, 1.0, 1.0])
    asked = [args["amplitude_rad"][0] for verb, args in robot.asked if verb == "reference" and args]
    assert all(after <= MOST_GROWTH * before + 1e-9 for before, after in pairwise(asked))
    assert grown(0.5, 0.1) == 0.5


@pytest.mark.parametrize(
    ("goal", "asked", "words", "terms"),
    [
        ("track 0.7 Hz", {}, "sine 0.7 Hz, from the goal's text; amplitude as the limits allow", {"frequency_hz": 0.7}),
        ("least error", {}, "sine 0.5 Hz, the default; amplitude as the limits allow", {"frequency_hz": 0.5}),
        ("7 Hz", {"frequency_hz": [2.0]}, "sine 2 Hz, as asked; amplitude as the limits allow", {"frequency_hz": 2.0}),
        ("0.7 Hz", {"kind": "multisine", "frequency_hz": [0.5, 0.75], "amplitude_rad": [0.2]},
         "multisine 0.5, 0.75 Hz, as asked; amplitude as asked", {"amplitude_rad": [0.2], "frequency_hz": [0.5, 0.75]}),
        ("", {"kind": "chirp", "frequency_hz": [0.2, 2.0], "duration_s": 8.0},
         "chirp 0.2, 2 Hz, as asked; amplitude as the limits allow", {"from_hz": 0.2, "to_hz": 2.0, "duration_s": 8.0}),
    ],
)  # fmt: skip
def test_the_motion_is_what_was_asked_for_and_says_who_said_so(
    goal: str, asked: dict[str, Any], words: str, terms: dict[str, Any]
) -> None:
    made = reference_of([{"name": "a", **JOINT}], goal, Asked(**asked))
    assert made.words == words
    assert {key: made.terms[key] for key in terms} == terms


def test_measured_are_whole_periods_and_a_faster_sine_is_smaller(tmp_path: Path) -> None:
    joints = [{"name": "a", **JOINT}]
    slow, fast = (reference_of(joints, f"{hertz} Hz", Asked()) for hertz in (0.3, 2.0))
    assert slow.window_s(4.0) == pytest.approx(2 / 0.3) and fast.window_s(4.0) == pytest.approx(4.0)
    assert fast.terms["amplitude_rad"][0] == pytest.approx(slow.terms["amplitude_rad"][0] / 16)
    file = tmp_path / "steps.json"
    file.write_text('{"kind": "steps", "position_rad": [[0.0], [0.5]], "every_s": 1.5}')
    steps = reference_of(joints, "", Asked(str(file)))
    assert steps.window_s(4.0) == 3.0 and not steps.repeats and not steps.grows and steps.words == "steps of steps.json"
    assert steps.at(0.1)["position_rad"] == [[0.0], [0.5]], "what was asked for is not made smaller"


def test_the_growth_is_a_number_from_1_to_2(capsys: pytest.CaptureFixture[str]) -> None:
    parser = argparse.ArgumentParser()
    motion_options(parser)
    assert parser.parse_args(["--growth", "1.2"]).growth == 1.2
    for wrong in ("x", "nan", "0.5", "3"):
        with pytest.raises(SystemExit):
            parser.parse_args(["--growth", wrong])
        assert f"'{wrong}' is no number from 1 (no growth) to 2" in capsys.readouterr().err


def test_a_motion_that_is_none_is_refused_with_the_next_step(tmp_path: Path) -> None:
    joints = [{"name": "a", **JOINT}]
    (tmp_path / "a.json").write_text("[1]")
    (tmp_path / "stays.json").write_text('{"kind": "steps", "position_rad": [[0.0]], "every_s": 1, "stay": true}')
    for goal, asked, words in (
        ("track 50 Hz", Asked(), "at most 5 Hz"),
        ("", Asked("multisine"), "--frequency-hz, all of them"),
        ("", Asked("chirp", [1.0]), "the first and the last"),
        ("", Asked("triangle"), "a JSON file"),
        ("", Asked(str(tmp_path / "a.json")), "holds no object"),
        ("", Asked(str(tmp_path / "stays.json")), "has no argument 'stay'"),
    ):
        with pytest.raises(LitheError, match=words):
            reference_of(joints, goal, asked)
    with pytest.raises(LitheError, match="at most 60 s are measured"):
        reference_of(joints, "", Asked("multisine", [0.5001, 0.75])).window_s(4.0)


def test_a_motion_that_ends_is_run_anew_for_each_law(tmp_path: Path) -> None:
    file = tmp_path / "steps.json"
    file.write_text('{"kind": "steps", "position_rad": [[0.0], [0.5]], "every_s": 1.5}')
    robot = FakeRobot()
    link = Link(robot, sleep=robot.sleep, now_s=lambda: robot.now)
    moves = Streamer(link, reference_of(link.joints, "", Asked(str(file))))
    result = Rounds(link, moves, FakeModel([0.3, 0.2]), "steps", Limits(rounds=2)).run()
    assert [one.share for one in result.tries] == [1.0, 1.0, 1.0] and result.best == 2
    begun = [args for verb, args in robot.asked if verb == "set_reference"]
    assert len(begun) == 4 and all(args["kind"] == "steps" for args in begun), "once before the first"


def test_the_whole_goal_the_motion_and_the_score_reach_the_model() -> None:
    goal = "carry a cup: " + "never spill, " * 200 + "END"
    robot = FakeRobot()
    link = Link(robot, sleep=robot.sleep, now_s=lambda: robot.now)
    model = FakeModel([0.3])
    Rounds(link, streamer(link), model, goal, Limits(rounds=1, window_s=2.0, score="max")).run()
    told = model.asked[0][1]["content"]
    assert goal in told and "largest error [deg]" in told and "sine 0.5 Hz, the default" in told


def test_each_score_finds_its_own_best() -> None:
    old = Measured(1, [1.0, 1.0], [3.0, 3.0], [0.5, 0.5])
    calm = Measured(2, [1.05, 1.0], [4.0, 3.0], [0.4, 0.4])
    even = Measured(3, [1.2, 1.2], [2.0, 2.0], [0.6, 0.6])
    idle = Measured(4, [9.0, 9.0], [20.0, 20.0], [0.0, 0.0])
    fine = Measured(5, [0.5, 0.5], [3.0, 3.1], [0.5, 0.5])
    found = {kind: [better(one, old, old, kind) for one in (calm, even, idle, fine)] for kind in SCORES}
    assert found == {
        "rms": [False, False, False, True], "max": [False, True, False, False], "torque": [True, False, False, False],
    }  # fmt: skip


def test_a_reference_that_ended_is_started_again_and_one_that_runs_is_not() -> None:
    robot = FakeRobot()
    moves = streamer(Link(robot, sleep=robot.sleep, now_s=lambda: robot.now))
    moves.go_on()
    assert robot.moves["kind"] == "rest", "none was asked for"
    moves.start(1.0)
    moves.go_on()
    assert [verb for verb, _ in robot.asked].count("set_reference") == 1
    robot.moves = {"kind": "rest"}
    moves.go_on()
    assert robot.moves["kind"] == "sine"
    moves.stop()
    moves.go_on()
    assert robot.moves["kind"] == "rest"
