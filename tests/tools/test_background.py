# SPDX-License-Identifier: Apache-2.0
"""A test run that a shell started in the background, or nohup."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_what_the_tests_start_can_be_interrupted() -> None:
    """Else a test of Ctrl-C, or of a lost terminal, waits for a program that ignores it."""
    said = "import conftest, signal as s; print(s.getsignal(s.SIGINT) is s.default_int_handler, s.getsignal(s.SIGHUP))"
    ignoring = ["sh", "-c", 'trap "" INT HUP; exec "$@"', "sh", sys.executable, "-c", said]
    paths = {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}"}
    done = subprocess.run(ignoring, capture_output=True, text=True, env=paths, cwd=ROOT, timeout=60, check=True)
    assert done.stdout.split() == ["True", "0"], done.stdout
