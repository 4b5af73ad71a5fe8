# SPDX-License-Identifier: Apache-2.0
"""What made a release late, from the kernel's own records: tracefs tells which task had the Spine's core, and when an
interrupt came. Only root reads it, and only where it is mounted.

Time counts as stolen when it passed and the thread did not use it. A kernel that leaves interrupts out of a thread's
time makes them look the same: only the trace tells them apart then.
"""

from __future__ import annotations

import contextlib
import gzip
import os
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Self

import numpy as np

from bench.isolation.figures import CAUSES, LEAST_US, PERIOD_NS, Records

TRACEFS = Path("/sys/kernel/tracing")
INSTANCE = "lithe_bench"  # a trace of our own: nobody else's is touched
EVENTS = ("sched/sched_switch", "irq/irq_handler_entry", "irq_vectors", "ipi/ipi_entry")  # those that this kernel has
BUFFER_KIB = 8192
INTERRUPT_NS = 50_000  # an interrupt, with what the kernel does after it, delays what comes within this time
PF_KTHREAD = 0x200000
CONFIGS = (Path("/proc/config.gz"), Path(f"/boot/config-{os.uname().release}"))
# What the kernel leaves out of a thread's processor time.
LEFT_OUT = {
    "machine_irq_time_accounting": b"CONFIG_IRQ_TIME_ACCOUNTING=y",
    "machine_steal_accounting": b"CONFIG_PARAVIRT_TIME_ACCOUNTING=y",
}
LINE = re.compile(r"\s(\d+)\.(\d{6}): (\w+):(.*)")
KERNEL_THREAD, TICK, INTERRUPT, OTHER_TASK, UNKNOWN = map(
    CAUSES.index, ("kernel_thread", "tick", "interrupt", "other_task", "unknown")
)
Span = tuple[int, int, int]  # from, until [ns of CLOCK_MONOTONIC], index in CAUSES


def accounting(configs: Iterable[Path] = CONFIGS) -> dict[str, bool | None]:
    """The figures LEFT_OUT, from the kernel's configuration; None: no file tells it."""
    for path in configs:
        with contextlib.suppress(OSError):
            text = path.read_bytes()
            lines = (gzip.decompress(text) if path.suffix == ".gz" else text).splitlines()
            return {key: line in lines for key, line in LEFT_OUT.items()}
    return dict.fromkeys(LEFT_OUT)


def is_kernel_thread(pid: int) -> bool:
    """Whether it is one; False for a task that has ended."""
    try:
        return bool(int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[6]) & PF_KTHREAD)
    except OSError:
        return False


def spans(trace: str, own: set[int], is_kernel: Callable[[int], bool] = is_kernel_thread) -> list[Span]:
    """What ran on the core instead of the tasks `own`, from the lines of a trace of this core."""
    found: list[Span] = []
    at_ns, since_ns, whose = 0, 0, -1
    for line in trace.splitlines():
        if not (seen := LINE.search(line)):
            continue
        at_ns, name, rest = int(seen[1] + seen[2]) * 1000, seen[3], seen[4]
        if name == "sched_switch" and (next_pid := re.search(r"next_pid=(\d+)", rest)):
            if whose >= 0:
                found.append((since_ns, at_ns, whose))
            pid = int(next_pid[1])
            since_ns, whose = at_ns, -1 if pid == 0 or pid in own else KERNEL_THREAD if is_kernel(pid) else OTHER_TASK
        elif name == "local_timer_entry" or "name=arch_timer" in rest:
            found.append((at_ns, at_ns + INTERRUPT_NS, TICK))
        elif name.endswith("_entry"):
            found.append((at_ns, at_ns + INTERRUPT_NS, INTERRUPT))
    return [*found, (since_ns, at_ns, whose)] if whose >= 0 else found


def attribute(records: Records, ran: list[Span]) -> None:
    """Write into each late record what ran between its release and its wake-up: the task that had most of it, else the
    tick, else another interrupt. When the kernel ran nothing, it is ours if the record says so, else unknown."""
    for at in np.flatnonzero(records["late_ns"] > LEAST_US * 1000):
        record = records[at]
        release_ns, woke_ns = int(record["release_ns"]), int(record["release_ns"] + record["late_ns"])
        took_ns = dict.fromkeys((KERNEL_THREAD, OTHER_TASK, TICK, INTERRUPT), 0)
        for since_ns, until_ns, cause in ran:
            took_ns[cause] += max(0, min(until_ns, woke_ns) - max(since_ns, release_ns))
        task = KERNEL_THREAD if took_ns[KERNEL_THREAD] > took_ns[OTHER_TASK] else OTHER_TASK
        ran_there = [cause for cause in (task, TICK, INTERRUPT) if took_ns[cause]]
        if record["told"] and sum(took_ns.values()) < record["late_ns"] / 2:
            continue  # ours: what came in that time explains too little of it
        records["told"][at] = 1 + ran_there[0] if ran_there else int(record["told"]) or 1 + UNKNOWN


def keep_interrupted(records: Records, ran: list[Span]) -> None:
    """Less time is stolen from what is less than a period from interrupts: each may have taken INTERRUPT_NS of it."""
    at_ns = np.sort([since_ns for since_ns, _, cause in ran if cause in (TICK, INTERRUPT)])
    ends_ns = records["release_ns"] + records["late_ns"] + PERIOD_NS
    near = np.searchsorted(at_ns, ends_ns) - np.searchsorted(at_ns, records["release_ns"] - PERIOD_NS)
    records["stolen_ns"] = np.maximum(records["stolen_ns"] - near * INTERRUPT_NS, 0)


class Trace:
    """The trace of one core, from entering to leaving. `why_not`: why there is none; then nothing is attributed.
    `untraced`: how many blocks of records had no whole trace. `apart`: interrupts may be left out of a thread's time.
    """

    def __init__(self, core: int, tracefs: Path = TRACEFS, *, apart: bool = False) -> None:
        self.why_not, self.untraced, self._apart = "", 0, apart
        self._core, self._folder, self._pipe = core, tracefs / "instances" / INSTANCE, -1

    def __enter__(self) -> Self:
        try:
            self._start()
        except OSError as why:
            self.why_not = f"{why}; root can read it after `mount -t tracefs nodev {TRACEFS}`"
            self.__exit__()
        return self

    def _start(self) -> None:
        core, folder = self._core, self._folder
        if folder.exists():  # of a run that was killed
            folder.rmdir()
        folder.mkdir()
        mask = ",".join([f"{1 << core % 32:x}", *["00000000"] * (core // 32)])
        (folder / "trace_clock").write_text("mono")
        (folder / "tracing_cpumask").write_text(mask)
        (folder / f"per_cpu/cpu{core}/buffer_size_kb").write_text(str(BUFFER_KIB))
        for event in EVENTS:
            with contextlib.suppress(FileNotFoundError):
                (folder / "events" / event / "enable").write_text("1")
        self._pipe = os.open(folder / f"per_cpu/cpu{core}/trace_pipe", os.O_RDONLY | os.O_NONBLOCK)

    def __exit__(self, *_: object) -> None:
        if self._pipe >= 0:
            os.close(self._pipe)
            self._pipe = -1
        with contextlib.suppress(OSError):
            self._folder.rmdir()

    def read(self) -> str | None:
        """What came since the last call; None without a trace, or when the kernel had to drop some of it."""
        pieces = []
        with contextlib.suppress(BlockingIOError):
            while self._pipe >= 0 and (piece := os.read(self._pipe, 1 << 20)):
                pieces.append(piece)
        text = b"".join(pieces).decode(errors="replace")
        return None if self._pipe < 0 or "LOST" in text else text

    def attribute(self, records: Records, pid: int) -> None:
        """The same for records of the process `pid` since the last read()."""
        text = self.read()
        self.untraced += text is None
        if text:
            ran = spans(text, {int(each) for each in os.listdir(f"/proc/{pid}/task")})
            attribute(records, ran)
            if self._apart:
                keep_interrupted(records, ran)
