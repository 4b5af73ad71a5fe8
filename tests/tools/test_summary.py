# SPDX-License-Identifier: Apache-2.0
"""The last line of `make test` says what each runner counted, also what failed, and names each test that ran twice."""

from pathlib import Path

import pytest
import stolen_time
import summary

pytest_plugins = ["pytester"]

CTEST = '<testsuite name="x" tests="12" failures="1" disabled="0" skipped="2"><testcase name="a"/></testsuite>'
PYTEST = (
    '<testsuites><testsuite errors="1" failures="2" skipped="3" tests="10">'
    '<testcase name="b"><skipped message="INCONCLUSIVE: the core was away"/></testcase></testsuite></testsuites>'
)


def test_both_kinds_of_files_are_read_and_a_missing_one_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ctest.xml").write_text(CTEST)
    (tmp_path / "pytest.xml").write_text(PYTEST)
    names = [str(tmp_path / f"{name}.xml") for name in ("ctest", "pytest", "pytest-again")]
    monkeypatch.setattr("sys.argv", ["summary.py", *names])
    assert summary.main() == 0
    assert capsys.readouterr().out == (
        "test: ctest 9 passed, 1 failed, 2 skipped · pytest 4 passed, 3 failed, 2 skipped, 1 inconclusive\n"
    )


FLAKY = """
import os, pathlib

def fails_once(name):
    seen = pathlib.Path(name)
    second = seen.exists()
    seen.touch()
    assert second

def test_passes(): pass
def test_is_flaky(): fails_once("flaky")
def test_is_broken(): assert False
def test_lost_its_time(): fails_once("lost") if "PYTEST_XDIST_WORKER" not in os.environ else None
"""


def test_the_last_line_names_every_test_that_needed_its_repeat(
    pytester: pytest.Pytester, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The three runs of `make test`: beside others, the repeat of what failed there, and what runs alone."""
    monkeypatch.setenv("PYTHONPATH", str(Path(stolen_time.__file__).parent))
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    pytester.makeconftest("import stolen_time\nstolen_time.StolenTime.stolen_s = lambda _: 0.3\n")
    pytester.makepyfile(test_room=FLAKY)
    for name, words in (
        ("pytest", ("-n", "1")),
        ("pytest-again", ("--last-failed", "--lfnf=none")),
        ("alone", ("-p", "no:cacheprovider", "-k", "passes or time")),
    ):
        pytester.runpytest_subprocess("-p", "stolen_time", *words, f"--junitxml={name}.xml")
    capsys.readouterr()
    monkeypatch.setattr("sys.argv", ["summary.py", "pytest.xml", "pytest-again.xml", "alone.xml"])
    assert summary.main() == 0
    assert capsys.readouterr().out == (
        "test: pytest 2 passed, 2 failed, 0 skipped · pytest-again 1 passed, 1 failed, 0 skipped · "
        "alone 2 passed, 0 failed, 0 skipped · 3 needed a repeat: test_room.py::test_is_flaky (passed), "
        "test_room.py::test_is_broken (failed), test_room.py::test_lost_its_time (passed)\n"
    )


def test_a_cpp_test_that_needed_its_repeat_is_named_as_ctest_names_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    case = '<testcase name="DogTest.Barks" classname="DogTest.Barks"/>'
    (tmp_path / "ctest-again.xml").write_text(f'<testsuite tests="1" failures="0" skipped="0">{case}</testsuite>')
    monkeypatch.setattr("sys.argv", ["summary.py", str(tmp_path / "ctest-again.xml")])
    assert summary.main() == 0
    assert capsys.readouterr().out == (
        "test: ctest-again 1 passed, 0 failed, 0 skipped · 1 needed a repeat: DogTest.Barks (passed)\n"
    )


def test_where_nothing_ran_twice_no_test_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pytest.xml").write_text(PYTEST)
    monkeypatch.setattr("sys.argv", ["summary.py", str(tmp_path / "pytest.xml")])
    assert summary.main() == 0
    assert "repeat" not in capsys.readouterr().out
