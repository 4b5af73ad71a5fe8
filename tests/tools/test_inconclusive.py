# SPDX-License-Identifier: Apache-2.0
"""A test that proved nothing is counted by its own word, and not among the skipped."""

from pathlib import Path

import inconclusive
import pytest

pytest_plugins = ["pytester"]

TESTS = """
import pytest
from inconclusive import inconclusive

def test_passes(): pass
def test_has_no_root(): pytest.skip("no root")
def test_lost_its_core(): inconclusive("2 of 100 releases were missed")
"""


@pytest.fixture
def suite(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    """One test of each kind, and no pytest-xdist around them."""
    monkeypatch.setenv("PYTHONPATH", str(Path(inconclusive.__file__).parent))
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    pytester.makepyfile(TESTS)
    return pytester


def test_an_inconclusive_test_is_counted_and_named(suite: pytest.Pytester) -> None:
    result = suite.runpytest_subprocess("-p", "inconclusive", "-p", "no:cacheprovider")
    assert result.parseoutcomes() == {"passed": 1, "skipped": 1, "inconclusive": 1}
    result.stdout.fnmatch_lines(["inconclusive: 1 (*::test_lost_its_core)", "*: INCONCLUSIVE: 2 of 100 releases *"])


def test_without_such_a_test_nothing_is_said_of_it(suite: pytest.Pytester) -> None:
    result = suite.runpytest_subprocess("-p", "inconclusive", "-p", "no:cacheprovider", "-k", "not core")
    assert result.parseoutcomes() == {"passed": 1, "skipped": 1, "deselected": 1}
    assert "inconclusive:" not in result.stdout.str()


def test_beside_others_it_fails_so_that_it_is_repeated_by_itself(suite: pytest.Pytester) -> None:
    """As `make test` does it: what failed in the first run is all that the second one runs."""
    first = suite.runpytest_subprocess("-p", "inconclusive", "-n", "1")
    assert first.parseoutcomes() == {"passed": 1, "skipped": 1, "failed": 1}
    assert "INCONCLUSIVE beside other tests: 2 of 100 releases were missed" in first.stdout.str()
    again = suite.runpytest_subprocess("-p", "inconclusive", "--last-failed", "--lfnf=none")
    assert again.parseoutcomes() == {"inconclusive": 1}
