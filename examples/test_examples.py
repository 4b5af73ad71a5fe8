# SPDX-License-Identifier: Apache-2.0
"""Every example runs as a person would run it, and prints what it promises."""

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


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.name)
def test_the_example_prints_what_it_promises(example: Path, rig: RobotRig) -> None:
    # As a shell has it: this process has limited numpy's threads by importing lithe itself.
    environment = {key: value for key, value in rig.env.items() if not key.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, example / "main.py", *WORDS.get(example.name, [])],
        env=environment | {"PYTHONPATH": str(ROOT / "brain"), "PYTHONWARNINGS": "error"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.stderr == ""
    expected = (example / "expected.txt").read_text(encoding="utf-8")  # *: what was measured
    assert fnmatchcase(done.stdout, expected), done.stdout
    assert len((example / "main.py").read_text(encoding="utf-8").splitlines()) <= 80


def test_there_are_six() -> None:
    assert [path.name[:2] for path in EXAMPLES] == ["01", "02", "03", "04", "05", "06"]
