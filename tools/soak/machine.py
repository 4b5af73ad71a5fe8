# SPDX-License-Identifier: Apache-2.0
"""What a soak does to the machine: load, memory, the time of day, a core. All of it ends by itself or by id."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from random import Random

from lithe.demo.processes import DIE_WITH_US
from lithe.programs import ROOT

CPUS = Path("/sys/devices/system/cpu")
BUSY = "while True: pass"
# argv: MiB, seconds. Where memory is short after all, the kernel shall end this process and no other.
TAKES = """
import sys, time
open("/proc/self/oom_score_adj", "w").write("1000")
taken = bytearray(int(sys.argv[1]) << 20)
for at in range(0, len(taken), 4096):
    taken[at] = 1
time.sleep(float(sys.argv[2]))
"""
MOST_MIB = 4096


class NotHere(Exception):
    """This machine does not permit it; the text says why."""


class Load:
    """Programs that use the machine up, beside the robot; each has a time limit of its own."""

    def __init__(self, log: Path) -> None:
        self._log = log
        self._running: list[subprocess.Popen[bytes]] = []

    def _begin(self, words: list[str], seconds: float) -> None:
        self._running = [each for each in self._running if each.poll() is None]
        command = [*DIE_WITH_US, "timeout", "-s", "KILL", f"{seconds:.1f}", *words]
        with self._log.open("ab") as log:
            self._running.append(
                subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True)
            )

    def start(self, loops: int, compilers: int, seconds: float) -> None:
        """Busy loops and compilers for so long, instead of those before."""
        self.close()
        for _ in range(loops):
            self._begin([sys.executable, "-IS", "-c", BUSY], seconds)
        law, contract = ROOT / "laws/lqr.cpp", ROOT / "spine/law/include"
        one = f"g++ -std=c++20 -O2 -I'{contract}' -c '{law}' -o /dev/null"
        for _ in range(compilers):
            self._begin(["bash", "-c", f"while {one}; do :; done"], seconds)

    def take_memory(self, share: float, seconds: float) -> None:
        """So much of the memory that is free now, 4 GiB at most."""
        words = [line.split() for line in Path("/proc/meminfo").read_text().splitlines()]
        free_mib = next(int(word[1]) for word in words if word[0] == "MemAvailable:") / 1024
        mib = min(int(share * free_mib), MOST_MIB)
        self._begin([sys.executable, "-IS", "-c", TAKES, str(mib), str(seconds)], seconds + 60)

    def close(self) -> None:
        """Ends those that still run, with all that they started: each is a process group of its own."""
        for process in self._running:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        self._running = []


def step_clock(step_s: float, for_s: float) -> None:
    """Steps the time of day, and back: by as much as CLOCK_MONOTONIC says that it should be by then."""
    real_s, steady_s = time.time(), time.monotonic()
    try:
        time.clock_settime(time.CLOCK_REALTIME, real_s + step_s)
    except OSError as why:
        raise NotHere(f"the clock cannot be set: {why}") from None
    try:
        time.sleep(for_s)
    finally:
        time.clock_settime(time.CLOCK_REALTIME, real_s + time.monotonic() - steady_s)


def unplug_core(random: Random, for_s: float) -> None:
    """Takes one core away, and gives it back; never the last one."""
    cores = [file for file in sorted(CPUS.glob("cpu[0-9]*/online")) if file.read_text().strip() == "1"]
    if not cores or len(os.sched_getaffinity(0)) < 2:
        raise NotHere(f"no core can be unplugged: {CPUS} has no core beside the first that is online")
    core = random.choice(cores)
    try:
        core.write_text("0")
    except OSError as why:
        raise NotHere(f"no core can be unplugged: {why}") from None
    try:
        time.sleep(for_s)
    finally:
        core.write_text("1")
