# SPDX-License-Identifier: Apache-2.0
"""Every example runs as a person would run it, and prints what it promises."""

import os
import subprocess
import sys
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path

import calm
import pytest
from system.robot_rig import ROOT, RobotRig

EXAMPLES = sorted(path for path in Path(__file__).parent.iterdir() if (path / "main.py").exists())
WORDS = {"06_policy": ["80"]}  # so few candidates take seconds


@pytest.fixture(scope="module")
def rig() -> Iterator[RobotRig]:
    """One robot for all of them, one after the other."""
    with calm.calm_robot() as running:
        yield running


def run(example: Path, env: dict[str, str], *words: str) -> subprocess.CompletedProcess[str]:
    """As a shell has it: this process has limited numpy's threads by importing lithe itself."""
    environment = {key: value for key, value in env.items() if not key.endswith("_NUM_THREADS")}
    return subprocess.run(
        [sys.executable, example / "main.py", *words],
        env=environment | {"PYTHONPATH": str(ROOT / "brain"), "PYTHONWARNINGS": "error"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.name)
def test_the_example_prints_what_it_promises(example: Path, rig: RobotRig) -> None:
    done = run(example, rig.env, *WORDS.get(example.name, []))
    assert done.stderr == ""
    expected = (example / "expected.txt").read_text(encoding="utf-8")  # *: what was measured
    assert fnmatchcase(done.stdout, expected), done.stdout
    assert len((example / "main.py").read_text(encoding="utf-8").splitlines()) <= 80


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.name)
def test_without_a_robot_it_says_so_at_once_and_what_next(example: Path, tmp_path: Path) -> None:
    env = os.environ | {"LITHE_RUN_DIR": str(tmp_path), "LITHE_SHM_PREFIX": tmp_path.name}
    done = run(example, env)
    assert (done.returncode, done.stdout) == (1, "")
    said = f"no robot runs here (no supervisor answers in {tmp_path})\n  next: lithe run ROBOT.toml\n"
    assert done.stderr == said


def test_a_number_of_candidates_that_is_none_is_told(tmp_path: Path) -> None:
    for word in ("many", "0", "-3"):
        done = run(EXAMPLES[5], os.environ | {"LITHE_RUN_DIR": str(tmp_path)}, word)
        assert done.returncode == 1 and done.stderr.endswith(f", not {word}\n  next: main.py 640\n")


def test_there_are_six() -> None:
    assert [path.name[:2] for path in EXAMPLES] == ["01", "02", "03", "04", "05", "06"]
