# SPDX-License-Identifier: Apache-2.0
"""Counts of the kernel about a process and a core, for `make bench-swap`."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from lithe.demo.evidence import STEAL_STEP_NS, stolen_ticks
from lithe.demo.processes import DIE_WITH_US

# On x86 their names are TLB, CAL, RES and LOC, on ARM IPI0, IPI1 ...; the descriptions after the counts are the same.
INTERRUPTS = ("TLB shootdowns", "Function call interrupts", "Rescheduling interrupts", "Local timer interrupts")
MOST_COMPILE_S = 60
SETTLE_NS = 50_000_000  # after a pause, a law's output may have steps for this time


def interrupts(cpu: int) -> npt.NDArray[np.float64]:
    """The count of each of INTERRUPTS on this core since boot; NaN for those that this machine does not have."""
    lines = Path("/proc/interrupts").read_text().splitlines()
    column = lines[0].split().index(f"CPU{cpu}") + 1
    rows = {name: line.split()[column] for line in lines for name in INTERRUPTS if line.endswith(name)}
    return np.array([float(rows.get(name, "nan")) for name in INTERRUPTS])


def minor_faults(pid: int, tid: int) -> int:
    """Page faults of one thread that needed no disk."""
    return int(Path(f"/proc/{pid}/task/{tid}/stat").read_text().rsplit(")", 1)[1].split()[7])


def memory_kb(pid: int) -> dict[str, int]:
    """Resident and virtual memory of a process."""
    words = [line.split() for line in Path(f"/proc/{pid}/status").read_text().splitlines()]
    sizes = {word[0].rstrip(":"): int(word[1]) for word in words if word[0] in ("VmRSS:", "VmSize:")}
    return {"rss_kb": sizes["VmRSS"], "size_kb": sizes["VmSize"]}


@dataclass
class StealWatch:
    """The times at which the stolen time of some cores grew; call look() every few milliseconds."""

    cpus: tuple[int, ...]

    def __post_init__(self) -> None:
        self.times_ns: list[int] = []
        self.counts: list[list[int]] = []
        self.first = {cpu: stolen_ticks(cpu) for cpu in self.cpus}
        self.look()

    def look(self) -> None:
        """Takes a sample."""
        self.counts.append([stolen_ticks(cpu)[0] for cpu in self.cpus])
        self.times_ns.append(time.monotonic_ns())

    def share(self, cpu: int) -> float:
        """Stolen share of the core's time since the start."""
        (stolen, total), (stolen_before, total_before) = stolen_ticks(cpu), self.first[cpu]
        return (stolen - stolen_before) / max(total - total_before, 1)

    def stolen_spans(self, cpu: int) -> list[tuple[int, int]]:
        """The spans in which the core was stolen, each with SETTLE_NS after it.

        The kernel adds the stolen time when the core is back: a pause of 100 ms increases the count at its end. So a
        span begins before the look that saw it, by the stolen time, plus one step because the count is rounded down,
        plus one for the time until the kernel counts.
        """
        grown = np.diff([row[self.cpus.index(cpu)] for row in self.counts])
        return [
            (
                min(self.times_ns[i], self.times_ns[i + 1] - (int(grown[i]) + 2) * STEAL_STEP_NS),
                self.times_ns[i + 1] + SETTLE_NS,
            )
            for i in np.flatnonzero(grown)
        ]


@contextlib.contextmanager
def compiling(cpu: int, commands: list[list[str]], most_s: float) -> Iterator[None]:
    """Real compilations, one after the other, with the lowest priority on one core, until the end or for `most_s`."""
    lines = [" ".join(f"'{word}'" for word in ["timeout", str(MOST_COMPILE_S), *command]) for command in commands]
    script = f"while [ $SECONDS -lt {int(most_s)} ]; do {'; '.join(lines)}; done"
    words = [*DIE_WITH_US, "taskset", "-c", str(cpu), "nice", "-n", "19", "bash", "-c", script]
    load = subprocess.Popen(words, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(load.pid, signal.SIGKILL)  # also the compiler that is running
        load.wait()
