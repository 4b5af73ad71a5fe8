# SPDX-License-Identifier: Apache-2.0
"""A failed test runs again after stolen time, and only then; a run in the background is one like any other."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import stolen_time

pytest_plugins = ["pytester"]
ROOT = Path(__file__).parents[2]

FLAKY = """
import pathlib, pytest

@pytest.fixture(scope="module")
def robot():
    made = pathlib.Path("made")
    made.write_text(made.read_text() + "x" if made.exists() else "x")
    return made

def test_passes_with_the_second_robot(robot):
    assert robot.read_text() == "xx"

def test_uses_the_second_robot_too(robot):
    assert robot.read_text() == "xx"

def test_that_never_passes():
    assert False
"""


@pytest.fixture(autouse=True)
def _by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """The inner runs have no pytest-xdist around them, unless they start one."""
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)


@pytest.mark.parametrize(("stolen_s", "passed", "failed"), [(0.3, 2, 1), (0.0, 0, 3)])
def test_a_failed_test_runs_again_after_stolen_time_only(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, stolen_s: float, passed: int, failed: int
) -> None:
    """With fixtures made anew; a real mistake fails twice."""
    monkeypatch.setattr(stolen_time.StolenTime, "stolen_s", lambda _: stolen_s)
    pytester.makepyfile(FLAKY)
    result = pytester.runpytest_inprocess("-p", "stolen_time", "-p", "no:cacheprovider")
    result.assert_outcomes(passed=passed, failed=failed)
    assert ("0.30 s of the processors' time" in result.stdout.str()) == (stolen_s > 0)


def test_one_stall_in_a_long_file_is_enough(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    """0.3 s of an hour, in the first test: the second, which has failed since, runs again."""
    spent = iter([20.0, 20.0, 20.3, 20.3, 20.3, 20.3, 20.3])
    monkeypatch.setattr(stolen_time, "stolen_s", lambda: next(spent))
    pytester.makepyfile("def test_passes(): pass\n" + FLAKY)
    result = pytester.runpytest_inprocess("-p", "stolen_time", "-p", "no:cacheprovider")
    result.assert_outcomes(passed=3, failed=1)
    assert "0.30 s of the processors' time" in result.stdout.str()


ONCE = """
import pathlib

def test_that_never_passes():
    with pathlib.Path("runs").open("a") as runs:
        runs.write("x")
    assert False
"""


def test_no_test_has_more_than_one_repeat(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `make test` does it: beside others, then what failed there by itself. Time is stolen all along."""
    monkeypatch.setenv("PYTHONPATH", str(Path(stolen_time.__file__).parent))
    pytester.makeconftest("import stolen_time\nstolen_time.StolenTime.stolen_s = lambda _: 0.3\n")
    pytester.makepyfile(ONCE)
    for words in (("-n", "1"), ("--last-failed", "--lfnf=none")):
        result = pytester.runpytest_subprocess("-p", "stolen_time", *words)
        result.assert_outcomes(failed=1)
        assert "run once more" not in result.stdout.str()
    assert (pytester.path / "runs").read_text() == "xx"
    pytester.runpytest_subprocess("-p", "stolen_time").assert_outcomes(failed=1)  # as what is marked alone runs
    assert (pytester.path / "runs").read_text() == "xxxx"


def test_stolen_time_is_read_from_proc_stat(tmp_path: Path) -> None:
    """Steal is the eighth number."""
    stat = tmp_path / "stat"
    stat.write_text("cpu  10 20 30 40 50 60 70 80 90 100\ncpu0 1 1 1 1 1 1 1 1 1 1\n")
    assert stolen_time.stolen_s(stat) == pytest.approx(80 / os.sysconf("SC_CLK_TCK"))


def test_what_the_tests_start_can_be_interrupted() -> None:
    """Else a test of Ctrl-C, or of a lost terminal, waits for a program that ignores it."""
    said = "import conftest, signal as s; print(s.getsignal(s.SIGINT) is s.default_int_handler, s.getsignal(s.SIGHUP))"
    ignoring = ["sh", "-c", 'trap "" INT HUP; exec "$@"', "sh", sys.executable, "-c", said]
    paths = {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}"}
    done = subprocess.run(ignoring, capture_output=True, text=True, env=paths, cwd=ROOT, timeout=60, check=True)
    assert done.stdout.split() == ["True", "0"], done.stdout
