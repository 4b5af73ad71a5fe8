# SPDX-License-Identifier: Apache-2.0
"""Cores and thread counts, seen from fresh processes: what matters is what holds before numpy comes."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

BRAIN = Path(__file__).resolve().parents[1]
LOOK = """
import json, os
import lithe
print(json.dumps([sorted(os.sched_getaffinity(0)), os.environ.get("OPENBLAS_NUM_THREADS", "")]))
"""


def run(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A fresh Python in which nobody has limited anything yet."""
    clean = {
        key: value for key, value in os.environ.items() if not key.endswith("_NUM_THREADS") and key != "LITHE_BRAIN_CPU"
    }
    return subprocess.run(
        [sys.executable, "-c", code],
        env=clean | {"PYTHONPATH": str(BRAIN)} | environment,
        capture_output=True,
        text=True,
        check=False,
    )


def look(**environment: str) -> tuple[list[int], str]:
    """Cores and threads after `import lithe`."""
    cores, threads = json.loads(run(LOOK, **environment).stdout)
    return cores, threads


def test_importing_lithe_pins_the_brain_when_told_to() -> None:
    core = max(os.sched_getaffinity(0))
    assert look(LITHE_BRAIN_CPU=str(core)) == ([core], "1")


def test_importing_lithe_alone_limits_numpys_threads_and_pins_nothing() -> None:
    cores, threads = look()
    assert set(cores) == os.sched_getaffinity(0) and threads == "1"


def test_who_asks_for_more_threads_gets_them() -> None:
    assert look(OPENBLAS_NUM_THREADS="3")[1] == "3"


def threads_of_numpy(code: str) -> int:
    """Threads of a fresh process after `code` and some linear algebra."""
    code += "; import numpy as np, os; a = np.ones((300, 300)); a @ a; print(len(os.listdir('/proc/self/task')))"
    return int(run(code).stdout)


def test_numpy_after_lithe_has_one_thread() -> None:
    assert threads_of_numpy("import lithe") == 1


@pytest.mark.parametrize("core", ["9999", "99999999999999999999", "\u00b2", "two"])
def test_a_core_that_does_not_exist_is_no_reason_to_fail(core: str) -> None:
    cores, _ = look(LITHE_BRAIN_CPU=core)
    assert set(cores) == os.sched_getaffinity(0)


CHECK = "import warnings, lithe.place as p; warnings.simplefilter('error'); p.warn_if_late()"


def test_late_numpy_is_worth_a_warning() -> None:
    done = run("import numpy; " + CHECK)
    one_core = (os.cpu_count() or 1) == 1
    assert one_core or "numpy was imported before lithe" in done.stderr


@pytest.mark.parametrize("first", ["", "import lithe, numpy; "])
def test_numpy_after_lithe_is_not(first: str) -> None:
    assert run(first + CHECK).stderr == ""


def test_late_numpy_with_its_threads_limited_is_not() -> None:
    assert run("import numpy; " + CHECK, OMP_NUM_THREADS="1").stderr == ""
