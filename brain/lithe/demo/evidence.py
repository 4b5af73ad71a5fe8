# SPDX-License-Identifier: Apache-2.0
"""Processor time that the machine took from the Spine: the kernel's evidence for the cause of a missed release.

Two counts, both in ns since the thread or the machine started: how long a thread was ready to run and another one had
its core (`schedstat`), and how long the hypervisor ran somebody else on that core (`steal` in /proc/stat, which the
kernel gives in steps of 10 ms). A Spine that is slow by itself, or is stopped by a signal, adds to neither. Where the
kernel keeps no such count nothing is evidence, and every missed release is the Spine's own.
"""

from __future__ import annotations

import contextlib
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .losses import Releases, Window

STEAL_STEP_NS = 1_000_000_000 // os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Thread:
    """A thread of the Spine that must be in time. `alone`: no other program of LITHE may run on its core."""

    pid: int
    tid: int
    cpu: int
    alone: bool = True


def stolen_ticks(cpu: int) -> tuple[int, int]:
    """Clock ticks that the hypervisor took from a core, and all of them, since boot."""
    lines = Path("/proc/stat").read_text(encoding="ascii").splitlines()
    ticks = next([int(word) for word in line.split()[1:9]] for line in lines if line.split()[0] == f"cpu{cpu}")
    return ticks[7], sum(ticks)


def made_to_wait(pid: int, tid: int) -> int:
    """How often a thread had to leave its core to another one."""
    status = Path(f"/proc/{pid}/task/{tid}/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) for line in status if line.startswith("nonvoluntary_ctxt_switches"))


def _waited_ns(thread: Thread) -> int:
    try:
        return int(Path(f"/proc/{thread.pid}/task/{thread.tid}/schedstat").read_text(encoding="ascii").split()[1])
    except FileNotFoundError:  # the thread has ended, or the kernel keeps no such count
        return 0


def counts(threads: list[Thread]) -> tuple[int, int, int]:
    """Time [ns] that they have waited, and that was stolen, of all together: a core that two share counts once. Then
    how often another thread was given the core of one that could have gone on.
    """
    waited_ns = switches = 0
    for thread in threads:
        if thread.alone:  # else it may have waited for a compiler of LITHE's own, and nothing tells which it was
            waited_ns += _waited_ns(thread)
            with contextlib.suppress(OSError):
                switches += made_to_wait(thread.pid, thread.tid)
    cores = {thread.cpu for thread in threads}
    return waited_ns, sum(stolen_ticks(cpu)[0] for cpu in cores) * STEAL_STEP_NS, switches


def threads_of(info: Any, pid: int) -> list[Thread]:
    """The thread that ticks and, where it has a core of its own, the Transport's. `info` is the robot's RobotInfo."""
    others = {int(info["cpu_brain"]), int(info["cpu_housekeeping"])}
    spine, transport = int(info["cpu_spine"]), int(info["cpu_transport"])
    found = [Thread(pid, int(info["tid_spine"]), spine, spine not in others)]
    if int(info["transport_inline"]) or transport == spine:
        return found
    with contextlib.suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            tid = int(task.name)
            if tid != found[0].tid and os.sched_getaffinity(tid) == {transport}:
                found.append(Thread(pid, tid, transport, transport not in others))
    return found


@dataclass(frozen=True)
class Evidence:
    """The two counts over time, as they were looked at."""

    at_ns: npt.NDArray[np.int64]  # (n,) CLOCK_MONOTONIC
    waited_ns: npt.NDArray[np.int64]  # (n,)
    stolen_ns: npt.NDArray[np.int64]  # (n,)
    switches: int = 0

    def took_ns(self, window: Window) -> int:
        """How long the machine kept the Spine waiting, between the last look before the window and the second after.

        The kernel adds stolen time at its next timer interrupt and cuts it off to whole steps: where it grew at all,
        one step more may have been taken.
        """
        if len(self.at_ns) < 2:
            return 0
        first = max(int(np.searchsorted(self.at_ns, window[0], side="right")) - 1, 0)
        last = min(int(np.searchsorted(self.at_ns, window[1], side="left")) + 1, len(self.at_ns) - 1)
        stolen = int(self.stolen_ns[last] - self.stolen_ns[first])
        return int(self.waited_ns[last] - self.waited_ns[first]) + stolen + (STEAL_STEP_NS if stolen else 0)

    def told(self) -> dict[str, float]:
        """All of it, for the summary."""
        whole = [float(np.ptp(each)) * 1e-6 if len(each) else 0.0 for each in (self.waited_ns, self.stolen_ns)]
        return {"waited_ms": whole[0], "stolen_ms": whole[1], "involuntary_switches": self.switches}


EMPTY = np.zeros(0, np.int64)
NONE = Evidence(EMPTY, EMPTY, EMPTY)


class Watch:
    """Samples the counters of some threads; call look() every few milliseconds."""

    def __init__(self, threads: list[Thread]) -> None:
        self._threads = threads
        self._looks: list[tuple[int, ...]] = []
        self.look()

    def look(self) -> None:
        """Takes a sample."""
        self._looks.append((time.monotonic_ns(), *counts(self._threads)))

    def evidence(self) -> Evidence:
        """What was seen so far."""
        at_ns, *seen = np.array(self._looks, np.int64).T
        waited_ns, stolen_ns, switches = (np.maximum.accumulate(each) for each in seen)  # one that has ended counts 0
        return Evidence(at_ns, waited_ns, stolen_ns, int(switches[-1] - switches[0]))


def tally(made: Releases, windows: list[Window], evidence: Evidence, period_ns: int) -> dict[str, Any]:
    """Missed releases of some windows, and how many of them the machine has to answer for, window by window."""
    releases = missed = machine = 0
    for window in windows:
        first, end = (int(at) for at in np.searchsorted(made.due_ns, window))
        here = int(np.count_nonzero(made.skipped[first:end]))
        releases += end - first
        missed += here
        machine += min(here, round(evidence.took_ns(window) / period_ns)) if here else 0
    return {
        "releases": releases,
        "missed": missed,
        "share": missed / releases if releases else float("nan"),
        "machine": machine,
        "own": missed - machine,
    }
