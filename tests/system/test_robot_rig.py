# SPDX-License-Identifier: Apache-2.0
"""What the system tests stand on: they fail without programs, and leave nothing behind, whatever ends them."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from system import robot_rig as rigs
from system.cleanup import processes_of
from system.robot_rig import ROOT, RobotRig

pytest_plugins = ["pytester"]

TESTS = [path for folder in ("tests", "brain/tests", "examples") for path in (ROOT / folder).rglob("*.py")]
RUNNER = """
import sys, time
from system.robot_rig import RobotRig
rig = RobotRig()
rig.run()
print(rig.prefix, rig.dir, flush=True)
time.sleep(600)
"""


def test_missing_programs_fail_a_test(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And do not skip it."""
    monkeypatch.setattr(rigs, "BIN", tmp_path)
    with pytest.raises(AssertionError, match="no lithe in .*run `make`, or set LITHE_BIN_DIR"):
        RobotRig()


def test_a_killed_test_run_leaves_no_robot() -> None:
    """Neither the supervisor nor the Spine, which outlives its parents on purpose, nor a file."""
    paths = f"{ROOT / 'tests'}:{ROOT / 'brain'}"
    command = ["env", f"PYTHONPATH={paths}", f"LITHE_BIN_DIR={rigs.BIN}", sys.executable, "-c", RUNNER]
    runner = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert runner.stdout is not None
    prefix, directory = runner.stdout.readline().split()
    assert len(processes_of(prefix)) >= 3, "supervisor, compile service, Spine"
    runner.kill()
    runner.communicate()
    RobotRig.wait_for(lambda: not Path(directory).exists())
    assert processes_of(prefix) == []
    assert list(Path("/dev/shm").glob(f"{prefix}.*")) == []


LEAVES = """
import gc, subprocess

def test_fails_and_leaves_a_process():
    process = subprocess.Popen(["sleep", "5"])
    ring = [process]
    ring.append(ring)
    assert False

def test_makes_many_objects():
    gc.collect()
"""


def test_what_a_failed_test_left_fails_no_other(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its process is collected with a warning, and warnings are errors here."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT / "tests"))
    pytester.makepyfile(LEAVES)
    words = ("-p", "no:cacheprovider", "-W", "error")
    pytester.makeconftest('pytest_plugins = ["stolen_time"]')
    assert pytester.runpytest_subprocess(*words).parseoutcomes() == {"failed": 2}
    pytester.makeconftest((ROOT / "conftest.py").read_text())
    assert pytester.runpytest_subprocess(*words).parseoutcomes() == {"failed": 1, "passed": 1}


def skips(path: Path) -> list[str]:
    """The reasons for which tests in a file may be skipped, as they stand in its text."""
    calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
    return [
        ast.unparse(call)
        for call in calls
        if ast.unparse(call.func).split(".")[-1] in ("skip", "skipif", "importorskip")
    ]


EXCUSES = ("privilege", "root", "core")
COMPUTED = (  # the reason is computed there, and only there
    "test_vcan.py: pytest.skip(reason)",  # no QEMU, no kernel
    "booted.py: pytest.skip(reason)",  # the same
    "pypi.py: pytest.skip(str(why))",  # no network
    "test_robot.py: pytest.skip('no right to make a time namespace')",  # root, or a user namespace
    # Of an instruction that a processor may lack.
    "test_not_contained.py: pytest.skip(f'{platform.machine()} without that instruction')",
    "test_first_day.py: pytest.skip('no zsh here (Debian: apt-get install zsh)')",
    "simulated.py: pytest.skip(rig.log().strip().splitlines()[-1])",  # no MuJoCo
    # A kernel may refuse one to an ordinary user.
    "test_doctor.py: pytest.skip(f'no user namespace here: {tried.stderr.strip()}')",
    # The doctor judges a robot that runs, too; the script beside it does not. No test leaves one.
    "test_doctor.py: pytest.skip(f'a robot runs on this machine: {name}')",
    # A long form, of a program that only `make bench-isolation` builds.
    "test_bench_isolation_run.py: pytest.skip('bench_isolation is not built: make bench-isolation')",
    # The kernel's counts say that the machine took the core away, and the run fell short.
    "inconclusive.py: pytest.skip(f'{WORD}: {why}')",
)


def unexcused(paths: list[Path]) -> list[str]:
    """Skips for anything else, with the file's name."""
    reasons = [f"{path.name}: {reason}" for path in paths for reason in skips(path)]
    return [each for each in reasons if each not in COMPUTED and not any(word in each for word in EXCUSES)]


def test_only_privileges_and_cores_may_skip_a_test() -> None:
    """Everything else that is missing is a failure, but the network, an emulator, zsh, MuJoCo and Dask."""
    assert unexcused(TESTS) == []


def test_a_skip_for_another_reason_would_be_found(tmp_path: Path) -> None:
    """The control of the test above."""
    path = tmp_path / "test_x.py"
    path.write_text('import pytest\npytest.skip("no binaries")\n')
    assert unexcused([path]) == ["test_x.py: pytest.skip('no binaries')"]
    path.write_text('import pytest\nreason = "no binaries"\npytest.skip(reason)\n')
    assert unexcused([path]) == ["test_x.py: pytest.skip(reason)"]
