# SPDX-License-Identifier: Apache-2.0
"""`make check` says which step failed and what mends it."""

from pathlib import Path

import check
import pytest


def test_a_failing_step_prints_the_command_that_fixes_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert not check.run(check.Step("format", "echo spine/a.cpp:1 is ugly; false", "make format"))
    printed = capsys.readouterr().out
    assert "spine/a.cpp:1 is ugly" in printed
    assert "FAIL format" in printed
    assert "to fix: make format" in printed


def test_a_failure_inside_a_pipe_is_a_failure() -> None:
    assert not check.run(check.Step("pipe", "false | cat", "nothing"))


def test_a_passing_step_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert check.run(check.Step("quiet", "echo noise", "nothing"))
    assert len(capsys.readouterr().out.splitlines()) == 1


def test_a_step_that_this_machine_cannot_run_is_neither_passed_nor_failed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = [check.Step("here", "true", "nothing"), check.Step("elsewhere", "echo no QEMU here; exit 77", "nothing")]
    monkeypatch.setattr(check, "STEPS", steps)
    monkeypatch.setattr("sys.argv", ["check.py"])
    assert check.main() == 0
    printed = capsys.readouterr().out
    assert "no QEMU here" in printed and "skip elsewhere" in printed
    assert printed.splitlines()[-1] == "check: 1 of 2 passed, skipped: elsewhere"


def test_every_step_says_how_to_fix_it() -> None:
    assert all(step.fix for step in check.STEPS)
    assert len({step.name for step in check.STEPS}) == len(check.STEPS)


def test_long_steps_run_only_when_all_are_asked_for_or_by_name() -> None:
    every_merge = check.chosen([], everything=False)
    assert not any(step.long for step in every_merge)
    assert [step.name for step in check.STEPS if step not in every_merge] == [
        "rtsan-all",
        "asan-all",
        "mutants",
        "fuzz-long",
        "arm64-all",
        "boards",
        "debian13",
        "ctest-long",
        "pytest-long",
    ]
    assert check.chosen([], everything=True) == check.STEPS
    assert [step.name for step in check.chosen(["asan-all"], everything=False)] == ["asan-all"]


def test_the_long_tests_have_the_isolation_bench() -> None:
    assert "cmake --preset bench " in check.chosen(["pytest-long"], everything=False)[0].command


def test_two_short_steps_run_at_a_time_and_a_long_one_with_none_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Each of the two waits for the other's file; the long one is refused when one of them still runs.
    def meets(own: str, other: str) -> str:
        wait = f"for i in $(seq 200); do [ -e {tmp_path}/{other} ] && exit; sleep 0.05; done; exit 1"
        return f"touch {tmp_path}/{own} && ({wait}) && touch {tmp_path}/{own}.done"

    steps = [
        check.Step("long", f"[ -e {tmp_path}/a.done ] && [ -e {tmp_path}/b.done ]", "nothing", long=True),
        check.Step("a", meets("a", "b"), "nothing"),
        check.Step("b", meets("b", "a"), "nothing"),
    ]
    monkeypatch.setattr(check, "STEPS", steps)
    monkeypatch.setattr("sys.argv", ["check.py", "--all"])
    assert check.main() == 0
