# SPDX-License-Identifier: Apache-2.0
"""Counts of the kernel about a process and a core, for `make bench-swap`."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
from lithe.demo.evidence import STEAL_STEP_NS, Evidence, Thread, Watch
from lithe.demo.losses import Window
from lithe.demo.processes import DIE_WITH_US

# On x86 their names are TLB, CAL, RES and LOC, on ARM IPI0, IPI1 ...; the descriptions after the counts are the same.
INTERRUPTS = ("TLB shootdowns", "Function call interrupts", "Rescheduling interrupts", "Local timer interrupts")
COUNTED = ("interrupts_tlb", "interrupts_cal", "interrupts_res", "interrupts_loc", "interrupts_device")
MOST_COMPILE_S = 60
SETTLE_NS = 50_000_000  # after a pause, a law's output may have steps for this time


def interrupts(cpu: int, table: Path = Path("/proc/interrupts")) -> npt.NDArray[np.float64]:
    """The count of each of INTERRUPTS on this core since boot, NaN for those that this machine does not have; then the
    sum over all devices: the rows with a number."""
    lines = table.read_text().splitlines()
    column = lines[0].split().index(f"CPU{cpu}") + 1
    rows = {name: line.split()[column] for line in lines for name in INTERRUPTS if line.endswith(name)}
    devices = sum(float(line.split()[column]) for line in lines if line.split(":")[0].strip().isdecimal())
    return np.array([*(float(rows.get(name, "nan")) for name in INTERRUPTS), devices])


def minor_faults(pid: int, tid: int) -> int:
    """Page faults of one thread that needed no disk."""
    return int(Path(f"/proc/{pid}/task/{tid}/stat").read_text().rsplit(")", 1)[1].split()[7])


def memory_kb(pid: int) -> dict[str, int]:
    """Resident and virtual memory of a process."""
    words = [line.split() for line in Path(f"/proc/{pid}/status").read_text().splitlines()]
    sizes = {word[0].rstrip(":"): int(word[1]) for word in words if word[0] in ("VmRSS:", "VmSize:")}
    return {"rss_kb": sizes["VmRSS"], "size_kb": sizes["VmSize"]}


def watch_steal(cpu: int) -> Watch:
    """Samples the time that the hypervisor takes from a core; call look() every few milliseconds."""
    return Watch([Thread(0, 0, cpu, alone=False)])


def stolen_share(seen: Evidence) -> float:
    """Stolen share of the core's time."""
    return float(np.ptp(seen.stolen_ns)) / max(float(np.ptp(seen.at_ns)), 1.0)


def stolen_spans(seen: Evidence) -> list[Window]:
    """The spans in which the core was stolen, each with SETTLE_NS after it.

    The kernel adds the stolen time when the core is back: a pause of 100 ms increases the count at its end. So a
    span begins before the look that saw it, by the stolen time, plus one step because the count is rounded down,
    plus one for the time until the kernel counts.
    """
    grown_ns, at_ns = np.diff(seen.stolen_ns), seen.at_ns
    return [
        (int(min(at_ns[i], at_ns[i + 1] - grown_ns[i] - 2 * STEAL_STEP_NS)), int(at_ns[i + 1]) + SETTLE_NS)
        for i in np.flatnonzero(grown_ns)
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
