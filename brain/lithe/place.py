# SPDX-License-Identifier: Apache-2.0
"""Keeps the Brain off the Spine's core.

A BLAS that starts one thread a core beside a spinning Spine makes both slow: the Brain 12 to 20 times, the Spine
late. Its thread count is read once, when numpy is imported; so `import lithe` sets it first, to one unless the
environment says otherwise. `lithe.connect()` pins the calling thread, and those it starts later, to the Brain's core;
with LITHE_BRAIN_CPU set, `import lithe` does that already.
"""

from __future__ import annotations

import os
import sys
import warnings

THREAD_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")

# Read when `import lithe` begins: did numpy come first, and start its threads as it liked?
CAME_LATE = "numpy" in sys.modules and not any(os.environ.get(name) for name in THREAD_VARIABLES)


def pin(cpu: int) -> bool:
    """Pins this thread, and those it starts from now on, to one core; False if the kernel refuses."""
    try:
        os.sched_setaffinity(0, {cpu})
    except (OSError, ValueError, OverflowError):
        return False
    return True


def prepare() -> None:
    """Before numpy comes: one thread for its libraries, and the core of LITHE_BRAIN_CPU if there is such a variable."""
    for name in THREAD_VARIABLES:
        os.environ.setdefault(name, "1")
    if (text := os.environ.get("LITHE_BRAIN_CPU", "")).isdecimal():
        pin(int(text))


def warn_if_late() -> None:
    """Warns when numpy had started its threads before lithe could limit them."""
    if CAME_LATE and (os.cpu_count() or 1) > 1:
        warnings.warn(
            "numpy was imported before lithe: its threads may use the Spine's core; "
            "import lithe first, or set OPENBLAS_NUM_THREADS=1",
            stacklevel=3,
        )
