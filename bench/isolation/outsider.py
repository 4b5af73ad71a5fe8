# SPDX-License-Identifier: Apache-2.0
"""A user's program that nobody pins: numpy with a thread for each core. It starts before the bench chooses its cores
and before its shield rises, so that only the shield can keep it off the Spine's core; and is seen where it runs.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from lithe.demo.processes import DIE_WITH_US
from lithe.place import THREAD_VARIABLES

from bench import report
from bench.tables import Figures

PID = (
    "LITHE_BENCH_OUTSIDER"  # of the program: `lithe tune shield` lies between the process that starts it and the bench
)
LOOK_S = 0.02
PROGRAM = """
import signal
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGUSR1])
import numpy as np
many = np.random.default_rng().normal(size=(600, 600))
np.linalg.inv(many)
print("its threads are there", flush=True)
signal.sigwait([signal.SIGUSR1])
while True:
    np.linalg.inv(many)
"""


@contextlib.contextmanager
def beside(wanted: bool) -> Iterator[int | None]:
    """Its process id, when its threads are there; it ends with the `with`, or with this process. None: not wanted, or
    an earlier process, which has become `lithe tune shield`, has started it."""
    if not wanted or PID in os.environ:
        yield None
        return
    env = {name: value for name, value in os.environ.items() if name not in THREAD_VARIABLES}
    words = [*DIE_WITH_US, sys.executable, "-c", PROGRAM]
    with subprocess.Popen(words, env=env, stdout=subprocess.PIPE, start_new_session=True) as program:
        try:
            if program.stdout is None or not program.stdout.readline():
                raise report.Unmeasured("the program with numpy, which runs beside the robot, ended before it began")
            os.environ[PID] = str(program.pid)
            yield program.pid
        finally:
            os.environ.pop(PID, None)
            program.kill()


def fields(pid: int) -> list[list[str]]:
    """State and all that follows in /proc, of each of its threads."""
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*"):
        with contextlib.suppress(OSError):
            found.append((task / "stat").read_text().rpartition(")")[2].split())
    return found


@contextlib.contextmanager
def running(pid: int | None, spine: int, told: Figures) -> Iterator[None]:
    """It computes inside the `with`; then `told` has where its threads ran, and how often that was core `spine`."""
    if pid is None:
        yield
        return
    seen: Counter[int] = Counter()
    done, threads = threading.Event(), fields(pid)

    def look() -> None:
        while not done.wait(LOOK_S):
            seen.update(int(each[36]) for each in fields(pid) if each[0] == "R")

    watch = threading.Thread(target=look)
    told |= {"rogue_may_use": ",".join(map(str, sorted(os.sched_getaffinity(pid))))}
    os.kill(pid, signal.SIGUSR1)
    watch.start()
    try:
        yield
    finally:
        done.set()
        watch.join()
        told |= {"rogue_ended": all(each[0] in "ZX" for each in fields(pid))}
        os.kill(pid, signal.SIGKILL)
        looks = seen.total()
        told |= {"rogue_threads": len(threads), "rogue_looks": looks, "rogue_ran_on": ",".join(map(str, sorted(seen)))}
        told |= {"rogue_share_on_spine_core": seen[spine] / looks if looks else None}
