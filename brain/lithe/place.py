# SPDX-License-Identifier: Apache-2.0
"""Keeps the Brain off the Spine's core.

A BLAS that starts one thread a core beside a spinning Spine makes both slow: the Brain 12 to 20 times, the Spine
late. So the affinity and the thread counts must be set before numpy is imported; `import lithe` does both when
LITHE_BRAIN_CPU is set, and `lithe.connect()` pins the process in any case.
"""

from __future__ import annotations

import os
import sys
import warnings

THREAD_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


def pin(cpu: int) -> bool:
    """Pins this process (its present and future threads' parent) to one core; False if the kernel refuses."""
    try:
        os.sched_setaffinity(0, {cpu})
    except OSError:
        return False
    return True


def prepare(cpu: int | None = None) -> None:
    """Sets affinity and thread counts before numpy comes; without `cpu` and LITHE_BRAIN_CPU it does nothing."""
    text = os.environ.get("LITHE_BRAIN_CPU", "") if cpu is None else str(cpu)
    if not text.isdigit():
        return
    for name in THREAD_VARIABLES:
        os.environ.setdefault(name, "1")
    pin(int(text))


def warn_if_late() -> None:
    """Says so when numpy was imported before anything limited its threads."""
    if (
        "numpy" in sys.modules
        and not any(os.environ.get(name) for name in THREAD_VARIABLES)
        and (os.cpu_count() or 1) > 1
    ):
        warnings.warn(
            "numpy was imported before lithe: its thread pool may use the Spine's core; import lithe first with "
            "LITHE_BRAIN_CPU set, or set OPENBLAS_NUM_THREADS=1",
            stacklevel=3,
        )
