# SPDX-License-Identifier: Apache-2.0
"""The agent's loop against a robot that is made up: slow and broken connections, budgets, what is kept."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_robot import HOSTILE, FakeModel, FakeRobot, Once, best_deg, rms_deg, run, streamer
from lithe.agent import prompt, report
from lithe.agent.extract import NoLaw
from lithe.agent.link import Link
from lithe.agent.model import ModelError
from lithe.agent.prompt import Try
from lithe.agent.rounds import Limits, Result, Rounds
from lithe.agent.score import Measured
from lithe.agent.transcript import Transcript, broken_at
from lithe.errors import LitheError


@pytest.mark.parametrize("delay_s", [0.0, 0.1, 2.0])
def test_the_best_law_is_kept_and_a_worse_one_is_taken_back(delay_s: float) -> None:
    robot = FakeRobot(delay_s)
    result, _, _ = run(robot, [0.3, -1.0, 0.35, 5.0, 0.05, 0.1])
    assert [one.kept for one in result.tries] == [True, True, False, False, False, True, False]
    assert [one.verdict for one in result.tries[2:5]] == ["trial_failed", "confirmed", "rolled_back"]
    assert result.best == 5 and robot.laws[robot.active] == 0.05 and result.ratio == pytest.approx(8.0, rel=1e-3)


@pytest.mark.parametrize("seed", range(8))
def test_over_a_connection_that_breaks_the_best_of_what_was_kept_runs_in_the_end(seed: int) -> None:
    robot = FakeRobot(delay_s=0.05, drops=0.15, seed=seed)
    result, _, _ = run(robot, [0.3, 0.2, 0.25, 0.05, 0.1])
    assert robot.laws[robot.active] == pytest.approx(np.radians(best_deg(result)), rel=1e-3)
    assert not result.stopped and result.best > 0


def test_failures_in_a_row_the_budget_of_swaps_and_a_silent_model_end_it_with_the_best_law() -> None:
    robot = FakeRobot()
    silent = ModelError("timeout", "it did not answer", "wait")
    result, _, _ = run(robot, [0.2, silent, "prose", silent, 0.1], failures=3)
    assert "3 generations in a row" in result.why and robot.laws[robot.active] == 0.2
    result, _, _ = run(FakeRobot(), [0.3, 0.2, 0.1], swaps=2)
    assert "budget of 2 swaps" in result.why and result.best == 2


def test_a_law_that_was_answered_before_costs_no_swap() -> None:
    result, _, _ = run(FakeRobot(), [0.3, 0.3, 0.2])
    assert [one.verdict for one in result.tries[1:]] == ["confirmed", "repeated", "confirmed"] and result.swaps == 2


def test_the_text_of_the_law_at_the_start_is_read_from_the_robot_and_told() -> None:
    result, model, _ = run(FakeRobot(), [0.5])
    assert result.source == "// swaps/0007.cpp" and "// swaps/0007.cpp" in model.asked[0][1]["content"]


def test_errors_are_those_of_one_instant() -> None:
    result, _, _ = run(FakeRobot(), [0.3])
    assert rms_deg(result) == pytest.approx(np.degrees([0.4, 0.3]), rel=1e-3), "no speed times the sample's age in it"


@pytest.mark.parametrize("verb", ["activate", "history", "measure", "swap", "reference", "set_reference"])
def test_a_lost_answer_costs_nothing_but_time(verb: str) -> None:
    robot = FakeRobot()
    robot.laws, robot.active, robot.before = {1: 0.4, 2: 0.39}, 2, [1, 1]
    robot.count = 2
    once = Once(robot, verb)
    link = Link(once, within_s=30.0, sleep=robot.sleep, now_s=lambda: robot.now)
    model = FakeModel([0.35, 0.38, 0.2, 0.3])
    limits = Limits(rounds=4, window_s=2.0, share=1.0)
    result = Rounds(link, streamer(link), model, "least error", limits).run()
    assert once.verb == "" and [one.kept for one in result.tries] == [True, True, False, True, False]
    assert min(rms_deg(result)) > 1, "what was measured at rest does not count"
    assert robot.laws[robot.active] == 0.2 and not result.stopped
    assert all(args == {"law": robot.active} or robot.laws[args["law"]] > 0.3 for name, args in robot.asked
               if name == "activate"), "only ever the best law of its time"  # fmt: skip


def test_a_lease_that_another_took_meanwhile_ends_it_and_nothing_is_moved_any_more() -> None:
    robot = FakeRobot()
    said: list[str] = []
    once = Once(robot, "swap")
    link = Link(once, lambda kind, **_: said.append(kind), 30.0, robot.sleep, lambda: robot.now)
    link.take()

    def lost() -> None:
        robot.leased = False

    result = Rounds(link, streamer(link), FakeModel([lost, 0.1]), "least error", Limits(window_s=2.0)).run()
    assert result.stopped and "another client moves the robot" in result.why
    after = [verb for verb, _ in robot.asked][[verb for verb, _ in robot.asked].index("swap") + 1 :]
    assert set(after) <= {"lease", "status", "latest"}, after


@pytest.mark.parametrize("verb", ["", "measure", "activate"])
def test_a_law_that_another_client_put_in_stays_and_ends_it(verb: str) -> None:
    robot = FakeRobot()

    def other() -> None:
        if verb:
            robot.then = {verb: robot.other_law}
        else:
            robot.other_law()

    result, _, said = run(robot, [0.3, other, 0.25, 0.1], growth=1.0)
    assert result.stopped and "none of this run" in result.why
    assert robot.laws[robot.active] == 0.6 and said[-1][0] == "end"


@pytest.mark.parametrize("kind", ["committed", "verdict", "way_back"])
def test_a_disk_that_is_full_ends_it_with_the_best_law(kind: str) -> None:
    robot = FakeRobot()
    full = list[str]()

    def say(what: str, /, **_: Any) -> None:
        if what == kind or full:
            full.append(what)
            raise OSError("no space left")

    link = Link(robot, say, 30.0, robot.sleep, lambda: robot.now)
    limits = Limits(rounds=2, window_s=2.0, share=1.0)
    with pytest.raises(OSError, match="no space left"):
        Rounds(link, streamer(link), FakeModel([0.5, 0.45]), "least error", limits, say).run()
    assert robot.laws[robot.active] == 0.4 and robot.moves["kind"] == "rest" and full[-1] == "end"


def test_an_interrupt_under_a_law_that_is_not_compared_yet_ends_it_with_the_best_law() -> None:
    robot = FakeRobot()

    def interrupt() -> None:
        raise KeyboardInterrupt

    def commit() -> None:
        robot.then = {"swap": interrupt}

    result, _, _ = run(robot, [0.3, commit], growth=1.0)
    assert result.why == "interrupted" and not result.stopped and robot.laws[robot.active] == 0.3


def test_the_budget_counts_swaps_back_to_the_best_law() -> None:
    robot = FakeRobot()

    def forget() -> None:
        robot.then = {"swap": robot.before.clear}

    result, _, _ = run(robot, [0.1, forget, 0.05], growth=1.0, swaps=3)
    sent = [args["name"] for verb, args in robot.asked if verb == "swap"]
    assert sent == ["agent_001.cpp", "agent_002.cpp", "best_001.cpp"] and result.swaps == 3
    assert "budget of 3 swaps" in result.why and robot.laws[robot.active] == 0.1


def test_a_measurement_without_telemetry_is_given_up() -> None:
    robot = FakeRobot()
    link = Link(robot, sleep=robot.sleep, now_s=lambda: robot.now)
    robot.history = lambda fields, **_: {name: [] for name in fields}  # type: ignore[method-assign, assignment]
    with pytest.raises(LitheError, match="no telemetry came in 2 s"):
        link.measure(2.0)
    assert robot.now < 110


def test_a_robot_that_is_gone_is_given_up() -> None:
    robot = FakeRobot()
    result, _, _ = run(robot, [0.3, lambda: setattr(robot, "drops", 2.0)])
    assert result.stopped and "cannot be reached" in result.why


def test_foreign_text_in_a_prompt_is_quoted_and_bounded() -> None:
    _, model, _ = run(FakeRobot(), [-1.0, NoLaw("no_code", HOSTILE * 1000), 0.1])
    for messages in model.asked:
        told = messages[1]["content"]
        assert "\nIGNORE" not in told and len(told) < 40_000
        assert all(line.lstrip().startswith("DATA ") for line in told.splitlines() if "IGNORE" in line)
    assert json.loads(prompt.data("a\x1b[2J`\u202eb")) == "a [2J' b"


def test_the_transcript_shows_a_changed_line_and_the_report_escapes(tmp_path: Path) -> None:
    transcript = Transcript(tmp_path / "run")
    for number in range(5):
        transcript.add("generation", number=number)
    transcript.close()
    path = tmp_path / "run" / "transcript.jsonl"
    assert broken_at(path) is None
    lines = path.read_bytes().splitlines()
    path.write_bytes(b"\n".join([*lines[:2], lines[2].replace(b'"number": 2', b'"number": 7'), *lines[3:]]) + b"\n")
    assert broken_at(path) == 4
    path.write_bytes(b"\n".join([*lines[:2], *lines[3:]]) + b"\n")
    assert broken_at(path) == 3
    start = Try(0, "start", "confirmed", measured=Measured(1, [3.0], [5.0], [0.1]), kept=True)
    result = Result([start, Try(1, "x", "failed", "<img src=x>|")])
    text = report.write(result, tmp_path, HOSTILE, "coder", [HOSTILE]).read_text()
    assert "<img" not in text and "```" not in text and (tmp_path / "rmse.png").exists()
