# SPDX-License-Identifier: Apache-2.0
"""The effect of this machine on new memory, on a spinning thread and on a Brain: the numbers of docs/rt.md.

`python -m bench.host [--short]` -> out/bench/host.json and a table, in about a minute; `--short` runs one round
(LITHE_BENCH_SHORT=1 does the same). Conditions alternate, all on the core where the Spine would tick. Memory, the
release phase and nice -20: bench/host.cpp. The Brain: numpy inverts matrices with its default number of threads, and
with one thread on the Brain's core; each with and without a program that spins like a Spine. A measurement that the
kernel does not permit, such as nice -20 without root, is left out, with the reason.
"""

import contextlib
import os
import statistics
import subprocess
import sys
from collections.abc import Iterator

from lithe.demo.processes import DIE_WITH_US
from lithe.place import THREAD_VARIABLES

from bench import report
from bench.asked import Asked, bench_of_its_own
from bench.tables import Figures

ROUNDS, BLOCK_S = 5, 1.0
SPIN = """
import os
try:
    os.nice(-20)
except OSError:
    pass
print(flush=True)
while True:
    pass
"""
BRAIN = """
import os, sys, time
import numpy as np
matrix = np.random.default_rng(1).normal(size=(600, 600))
np.linalg.inv(matrix)
print(len(os.listdir("/proc/self/task")), flush=True)
for _ in sys.stdin:
    done, began = 0, time.perf_counter()
    while time.perf_counter() < began + float(sys.argv[1]):
        np.linalg.inv(matrix)
        done += 1
    print(done / (time.perf_counter() - began), flush=True)
"""


class Brain(Asked):
    """A process that computes for the time of a block on request; `told` is the number of its threads."""

    def __init__(self, core: int | None) -> None:
        """With one thread on that core; or, without a core, with numpy's default threads on any core."""
        env = {name: value for name, value in os.environ.items() if name not in THREAD_VARIABLES}
        if core is not None:
            env |= dict.fromkeys(THREAD_VARIABLES, "1")
        pinned = ["taskset", "-c", str(core)] if core is not None else []
        super().__init__("numpy's process", [*pinned, sys.executable, "-c", BRAIN, str(BLOCK_S)], env)


@contextlib.contextmanager
def spinning(core: int) -> Iterator[None]:
    """A program that spins on a core, with the priority of a Spine if the kernel permits it."""
    words = [*DIE_WITH_US, "taskset", "-c", str(core), sys.executable, "-c", SPIN]
    process = subprocess.Popen(words, stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None
        process.stdout.readline()
        yield
    finally:
        process.kill()
        process.communicate()


def brains(cores: Figures, rounds: int) -> Figures:
    """How much slower a spinning Spine makes numpy: with its own threads, and with one on the Brain's core."""
    spine, partner = int(cores["machine_spine_core"]), int(cores["machine_partner_core"])
    running: dict[str, Brain] = {}
    rates: dict[str, list[float]] = {}
    try:
        running["own"] = Brain(None)
        running["one"] = Brain(partner)
        for _ in range(rounds):
            for name, brain in running.items():
                rates.setdefault(f"{name}_alone", []).append(brain.ask())
            with spinning(spine):
                for name, brain in running.items():
                    rates.setdefault(f"{name}_beside", []).append(brain.ask())
        told: Figures = {f"host_brain_{key}_per_s": statistics.median(each) for key, each in rates.items()}
        for name, brain in running.items():
            ratios = [a / b for a, b in zip(rates[f"{name}_alone"], rates[f"{name}_beside"], strict=True)]
            key = f"host_brain_{name}"
            told |= {f"{key}_slower": statistics.median(ratios), f"{key}_threads": brain.told}
            told |= {f"{key}_slower_least": min(ratios), f"{key}_slower_most": max(ratios)}
        return told
    finally:
        for brain in running.values():
            brain.close()


def figures(short: bool) -> Figures:
    """All of them."""
    cores = report.cores()
    if not cores:
        raise report.Unmeasured("host needs bench_cores (make bench builds it) and two cores")
    return report.measure((*report.program("host"), "1" if short else "12")) | brains(cores, 1 if short else ROUNDS)


def main(words: list[str]) -> int:
    """Measure and show."""
    return bench_of_its_own("host", words, __doc__ or "", figures)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
