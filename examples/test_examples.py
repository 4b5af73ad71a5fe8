# SPDX-License-Identifier: Apache-2.0
"""Every example is run against a robot of its own, from the top of the tree, and its output compared."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from calm import calm_robot
from system.house import BIN, ROOT

EXAMPLES = sorted(path.parent for path in Path(__file__).parent.glob("*/main.py"))


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.name)
def test_prints_what_it_says(example: Path) -> None:
    """The example's output is its expected.txt, and it is short enough to read."""
    if not (BIN / "lithe-spine").exists():
        pytest.skip(f"no binaries in {BIN}: make, or set LITHE_BIN_DIR")
    assert len((example / "main.py").read_text().splitlines()) <= 80
    with calm_robot():
        environment = os.environ | {"PYTHONPATH": str(ROOT / "brain"), "OPENBLAS_NUM_THREADS": "1"}
        done = subprocess.run(
            [sys.executable, example / "main.py"], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120
        )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout == (example / "expected.txt").read_text()
