# SPDX-License-Identifier: Apache-2.0
"""`make test` repeats four tests at most, never those of some rooms; its last line names each test that ran twice."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import run_tests
import stolen_time

pytest_plugins = ["pytester"]

CTEST = '<testsuite name="x" tests="12" failures="1" disabled="0" skipped="2"><testcase name="a"/></testsuite>'
PYTEST = (
    '<testsuites><testsuite errors="1" failures="2" skipped="3" tests="10">'
    '<testcase name="b"><skipped message="INCONCLUSIVE: the core was away"/></testcase></testsuite></testsuites>'
)


def test_both_kinds_of_files_are_read_and_a_missing_one_is_left_out(
    tmp_path: Path,
) -> None:
    (tmp_path / "ctest.xml").write_text(CTEST)
    (tmp_path / "pytest.xml").write_text(PYTEST)
    assert run_tests.last_line([tmp_path / f"{name}.xml" for name in ("ctest", "pytest", "pytest-again")]) == (
        "test: ctest 9 passed, 1 failed, 2 skipped · pytest 4 passed, 3 failed, 2 skipped, 1 inconclusive"
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
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
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
    assert run_tests.last_line([Path("pytest.xml"), Path("pytest-again.xml"), Path("alone.xml")]) == (
        "test: pytest 2 passed, 2 failed, 0 skipped · pytest-again 1 passed, 1 failed, 0 skipped · "
        "alone 2 passed, 0 failed, 0 skipped · 3 needed a repeat: test_room.py::test_is_flaky (passed), "
        "test_room.py::test_is_broken (failed), test_room.py::test_lost_its_time (passed)"
    )


def test_a_cpp_test_that_needed_its_repeat_is_named_as_ctest_names_it(tmp_path: Path) -> None:
    case = '<testcase name="DogTest.Barks" classname="DogTest.Barks"/>'
    (tmp_path / "ctest-again.xml").write_text(f'<testsuite tests="1" failures="0" skipped="0">{case}</testsuite>')
    assert run_tests.last_line([tmp_path / "ctest-again.xml"]) == (
        "test: ctest-again 1 passed, 0 failed, 0 skipped · 1 needed a repeat: DogTest.Barks (passed)"
    )


def test_where_nothing_ran_twice_no_test_is_named(tmp_path: Path) -> None:
    (tmp_path / "pytest.xml").write_text(PYTEST)
    assert "repeat" not in run_tests.last_line([tmp_path / "pytest.xml"])


CMAKE = """cmake_minimum_required(VERSION 3.25)
project(x NONE)
enable_testing()
foreach(name a b c)
  add_test(NAME T.${name} COMMAND ${CMAKE_SOURCE_DIR}/${name})
  set_tests_properties(T.${name} PROPERTIES LABELS $ENV{LABEL})
endforeach()
"""
PRESETS = """{"version": 5,
"configurePresets": [{"name": "release", "generator": "Ninja", "binaryDir": "${sourceDir}/build/release"}],
"testPresets": [{"name": "release", "configurePreset": "release"}]}"""
PASSES, FAILS, FAILS_ONCE = "exit 0", "exit 1", "[ -e $0.ran ] || { touch $0.ran; exit 1; }"
ONCE = """import pathlib
def test_{0}():
    ran = pathlib.Path("ran{0}").exists()
    pathlib.Path("ran{0}").touch()
    assert ran
"""
STOLEN = """import pathlib, pytest
pytest_plugins = ["stolen_time"]
def test_it(): pass
@pytest.mark.alone
def test_that_lost_its_time():
    import stolen_time
    stolen_time.StolenTime.stolen_s = lambda _: 0.3
    ran = pathlib.Path("stolen").exists()
    pathlib.Path("stolen").touch()
    assert ran
"""


def make_test(folder: Path, label: str, scripts: tuple[str, str, str], python: str) -> tuple[int, str, str]:
    """`make test` of a project of three C++ tests of one room, and one file of Python."""
    (folder / "CMakeLists.txt").write_text(CMAKE)
    (folder / "CMakePresets.json").write_text(PRESETS)
    (folder / "test_it.py").write_text(python + "import pytest\n@pytest.mark.alone\ndef test_alone(): pass\n")
    (folder / "pytest.ini").write_text("[pytest]\nmarkers =\n  alone\n  long\n")
    for name, script in zip("abc", scripts, strict=True):
        (folder / name).write_text(f"#!/bin/sh\n{script}\n")
        (folder / name).chmod(0o755)
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST")}
    environment |= {"LABEL": label, "PYTHONPATH": str(Path(stolen_time.__file__).parent)}
    subprocess.run(["cmake", "--preset", "release"], cwd=folder, env=environment, check=True, capture_output=True)
    done = subprocess.run(
        [sys.executable, run_tests.__file__, "--workers", "2"],
        cwd=folder, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return done.returncode, done.stdout.splitlines()[-1], done.stderr


@pytest.mark.parametrize(
    ("label", "scripts", "python", "end", "says"),
    [
        ("robot", (PASSES, PASSES, PASSES), "def test_it(): pass\n", 0, "ctest 3 passed, 0 failed"),
        (
            "robot",
            (FAILS_ONCE, PASSES, PASSES),
            ONCE.format(1),
            0,
            "2 needed a repeat: T.a (passed), test_it.py::test_1",
        ),
        ("robot", (FAILS_ONCE, PASSES, PASSES), "".join(map(ONCE.format, range(4))), 1, "5 tests failed; at most 4"),
        ("robot", (FAILS_ONCE,) * 3, ONCE.format(0) + ONCE.format(1), 1, "5 tests failed; at most 4"),
        (
            "robot",
            (FAILS_ONCE, FAILS_ONCE, FAILS_ONCE),
            ONCE.format(0) + STOLEN,
            1,
            "5 tests were run a second time; at most 4",
        ),
        ("robot", (FAILS_ONCE, PASSES, PASSES), STOLEN, 0, "2 needed a repeat"),
        ("robot", (FAILS, PASSES, PASSES), "def test_it(): pass\n", 1, "1 needed a repeat: T.a (failed)"),
        ("tick.guard", (FAILS_ONCE, PASSES, PASSES), "def test_it(): pass\n", 1, "guard are never repeated: T.a"),
        ("robot", (PASSES, PASSES, PASSES), "import nothing_of_this_name\n", 1, "pytest-again 0 passed, 1 failed"),
    ],
)
def test_what_is_repeated_and_what_is_an_error(
    tmp_path: Path, label: str, scripts: tuple[str, str, str], python: str, end: int, says: str
) -> None:
    code, last, errors = make_test(tmp_path, label, scripts, python)
    assert (code, says in last + errors) == (end, True), (last, errors)


def test_a_runner_that_breaks_is_no_success(tmp_path: Path) -> None:
    code, _, errors = make_test(tmp_path, "robot", (PASSES, PASSES, PASSES), "import os\nos._exit(3)\n")
    assert code == 1 and "pytest broke" in errors, errors
