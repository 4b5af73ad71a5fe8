# SPDX-License-Identifier: Apache-2.0
"""Cores and thread counts, seen from fresh processes: what matters is what holds before numpy comes."""

import json
import os
import subprocess
import sys
from pathlib import Path

BRAIN = Path(__file__).resolve().parents[1]
LOOK = """
import json, os
{first}
import lithe
print(json.dumps([sorted(os.sched_getaffinity(0)), os.environ.get("OPENBLAS_NUM_THREADS", "")]))
"""


def look(first: str = "", **environment: str) -> tuple[list[int], str]:
    clean = {
        key: value for key, value in os.environ.items() if not key.endswith("_NUM_THREADS") and key != "LITHE_BRAIN_CPU"
    }
    done = subprocess.run(
        [sys.executable, "-c", LOOK.format(first=first)],
        env=clean | {"PYTHONPATH": str(BRAIN)} | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    cores, threads = json.loads(done.stdout)
    return cores, threads


def test_importing_lithe_pins_the_brain_when_told_to() -> None:
    core = max(os.sched_getaffinity(0))
    assert look(LITHE_BRAIN_CPU=str(core)) == ([core], "1")


def test_importing_lithe_alone_changes_nothing() -> None:
    cores, threads = look()
    assert set(cores) == os.sched_getaffinity(0) and threads == ""


def test_a_core_that_does_not_exist_is_no_reason_to_fail() -> None:
    cores, _ = look(LITHE_BRAIN_CPU="9999")
    assert set(cores) == os.sched_getaffinity(0)


def test_late_numpy_is_worth_a_warning() -> None:
    code = "import numpy, warnings, lithe.place as p\nwarnings.simplefilter('error')\np.warn_if_late()"
    clean = {key: value for key, value in os.environ.items() if not key.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=clean | {"PYTHONPATH": str(BRAIN)},
        capture_output=True,
        text=True,
        check=False,
    )
    one_core = (os.cpu_count() or 1) == 1
    assert one_core or "numpy was imported before lithe" in done.stderr
