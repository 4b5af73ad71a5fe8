# SPDX-License-Identifier: Apache-2.0
"""A failed test runs again after stolen time, and only then."""

from pathlib import Path

import pytest
import stolen_time
from stolen_time import Processors

pytest_plugins = ["pytester"]

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


@pytest.mark.parametrize(("stolen", "passed", "failed"), [(0.02, 2, 1), (0.0, 0, 3)])
def test_a_failed_test_runs_again_after_stolen_time_only(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, stolen: float, passed: int, failed: int
) -> None:
    """With fixtures made anew; a real mistake fails twice."""
    monkeypatch.setattr(stolen_time.StolenTime, "stolen", lambda _: stolen)
    pytester.makepyfile(FLAKY)
    result = pytester.runpytest_inprocess("-p", "stolen_time", "-p", "no:cacheprovider")
    result.assert_outcomes(passed=passed, failed=failed)
    assert ("2.0 % of the processors' time" in result.stdout.str()) == (stolen > 0)


def test_the_share_is_read_from_proc_stat(tmp_path: Path) -> None:
    """Steal is the eighth number; guests are counted in user already."""
    stat = tmp_path / "stat"
    stat.write_text("cpu  10 20 30 40 50 60 70 80 90 100\ncpu0 1 1 1 1 1 1 1 1 1 1\n")
    assert Processors.now(stat) == Processors(80, 360)
    assert Processors(80, 360).stolen_since(Processors(60, 160)) == pytest.approx(0.1)
    assert Processors(80, 360).stolen_since(Processors(80, 360)) == 0
