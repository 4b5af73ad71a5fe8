# SPDX-License-Identifier: Apache-2.0
"""The workloads of `make bench-isolation`: programs that know nothing of the Spine, always ended by process id."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from lithe.demo.processes import DIE_WITH_US, undisturbed
from lithe.place import THREAD_VARIABLES
from lithe.programs import ROOT

WORKLOADS = ("stress", "numpy", "compile", "swap", "idle")
SETTLE_S, READY_S = 2.0, 120.0
SWAPS = "swaps of the second robot"  # storm.py counts them in the log
END_S = 60.0  # after SIGINT; then SIGKILL. The swap storm has a robot to stop, on a busy core
APT = "sudo apt-get install -y --no-install-recommends"
BY_HAND = "move all tasks off the Spine's core with taskset first (docs/rt.md)"

# A Brain that did not import lithe: numpy takes a thread for each core it may use. argv: seconds, cores.
# Its threads move to the given cores after they were started, so there are as many on one core as on all.
SPRAWL = """
import os, sys, time
import numpy as np
rng = np.random.default_rng()
np.linalg.inv(rng.normal(size=(600, 600)))
for task in os.listdir("/proc/self/task"):
    os.sched_setaffinity(int(task), {int(core) for core in sys.argv[2].split(",")})
end = time.monotonic() + float(sys.argv[1])
while time.monotonic() < end:
    np.linalg.inv(rng.normal(size=(600, 600)))
"""
# In place of stress-ng: FFTs in one process a core, and one that writes 64 MiB again and again. argv: seconds, cores.
STRESS = """
import os, sys, time
import numpy as np
os.sched_setaffinity(0, {int(core) for core in sys.argv[2].split(",")})
parent = os.getpid()
number = next((i for i in range(1, os.cpu_count() + 1) if os.fork() == 0), 0)
block, many = np.random.default_rng(number).normal(size=4096), np.zeros(8 << 20)
end = time.monotonic() + float(sys.argv[1])
while time.monotonic() < end and (number == 0 or os.getppid() == parent):
    np.fft.fft(block) if number else many.__iadd__(1.0)
"""


@dataclass(frozen=True)
class Load:
    """Commands that run side by side, and what they are in words."""

    words: str
    commands: tuple[tuple[str, ...], ...] = ()
    ready: str = ""  # when this is in the log, it has started


def stress(cores: str, most_s: float) -> Load:
    """The paper's command; `--cpu 0` starts one worker for each core, without it there would be none."""
    limits = (f"{most_s:.0f}", cores)
    if not shutil.which("stress-ng"):
        words = f"built-in load: numpy FFTs on every core and 64 MiB of writes (stress-ng is missing: {APT} stress-ng)"
        return Load(words, ((sys.executable, "-c", STRESS, *limits),))
    asked = "stress-ng --cpu 0 --cpu-method fft --vm 1 --vm-bytes 64M"
    return Load(asked, (("taskset", "-c", cores, *asked.split(), "--timeout", limits[0]),))


def numpy(every_core: str, brain: int, most_s: float) -> Load:
    """Thread sprawl on the Brain's core; it starts on every core, since numpy counts those it may use. Beside it runs
    the program of outsider.py, which nobody pins."""
    words = f"600x600 inversions: a thread for each core, all on core {brain}; the same in a rogue program, not pinned"
    sprawl = ("taskset", "-c", every_core, sys.executable, "-c", SPRAWL, f"{most_s:.0f}", str(brain))
    return Load(words, (sprawl,))


def compile_storm(cores: str, most_s: float) -> Load:
    """As many compilers as cores, one law after the other."""
    laws = sorted((ROOT / "laws").glob("*.cpp"))
    # One that cannot compile is no load: then the storm ends, and the run says so.
    compiler = f"g++ -std=c++20 -O2 -I'{ROOT}/spine/law/include'"
    one = "; ".join(f"{compiler} -c '{law}' -o /dev/null || exit 1" for law in laws)
    script = f"while [ $SECONDS -lt {int(most_s)} ]; do {one}; done"
    count = os.cpu_count() or 1
    words = f"{count} x g++ -O2, {len(laws)} laws one after the other, at nice 0"
    return Load(words, (("taskset", "-c", cores, "bash", "-c", script),) * count)


def swap_storm(brain: int, folder: Path, most_s: float) -> Load:
    """A second robot; and the rig swaps (run.py)."""
    words = (
        "the measured Spine is offered a fresh copy of its law every 20 ms (commit, State carried); on core "
        f"{brain} a second robot (`lithe run`, release sleep) compiles, tries, places and swaps laws without pause"
    )
    storm = (sys.executable, "-m", "bench.isolation.storm", str(folder), f"{most_s:.0f}")
    return Load(words, (("taskset", "-c", str(brain), *storm),), ready=f"1 {SWAPS}")


def load_of(workload: str, cores: str, every_core: str, brain: int, folder: Path, most_s: float) -> Load:
    """One of WORKLOADS. `cores`: where its programs may run, as in 0,1; they end by themselves after `most_s`."""
    match workload:
        case "stress":
            return stress(cores, most_s)
        case "numpy":
            return numpy(every_core, brain, most_s)
        case "compile":
            return compile_storm(cores, most_s)
        case "swap":
            return swap_storm(brain, folder, most_s)
    return Load("nothing")


def end(process: subprocess.Popen[bytes]) -> None:
    """Ends a load and all that it started: its process group, which has its process id."""
    for number, patience_s in ((signal.SIGINT, END_S), (signal.SIGKILL, END_S)):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(patience_s)


@contextlib.contextmanager
def running(load: Load, log: Path) -> Iterator[list[subprocess.Popen[bytes]]]:
    """The load runs inside the `with`. Its programs do not have the variables that limit numpy's threads or name the
    cores to measure on."""
    kept_out = (*THREAD_VARIABLES, "LITHE_BENCH_CORES")
    env = {name: value for name, value in os.environ.items() if name not in kept_out}
    started: list[subprocess.Popen[bytes]] = []
    try:
        with log.open("ab") as file:
            for command in load.commands:
                words = [*DIE_WITH_US, *command]
                started.append(subprocess.Popen(
                    words, stdout=file, stderr=file, stdin=subprocess.DEVNULL, env=env, cwd=ROOT, start_new_session=True
                ))  # fmt: skip
        end_s = time.monotonic() + (READY_S if load.ready else SETTLE_S)
        while time.monotonic() < end_s and not (load.ready and load.ready in log.read_text(errors="replace")):
            time.sleep(0.1)
        yield started
    finally:
        with undisturbed():
            for process in started:
                end(process)


def swaps_in(log: Path) -> int:
    """How many swaps of the second robot the log counts."""
    return log.read_text(errors="replace").count(SWAPS)


def ended_early(started: list[subprocess.Popen[bytes]]) -> bool:
    """A load that ended before it was told to is no load."""
    return any(process.poll() is not None for process in started)
