# SPDX-License-Identifier: Apache-2.0
"""The effect of this machine on new memory, on a spinning thread and on a Brain: the numbers of docs/rt.md.

`python -m bench.host [--short]` -> out/bench/host.json and a table, in about a minute; `--short` runs one round
(LITHE_BENCH_SHORT=1 does the same). Conditions alternate, all on the core where the Spine would tick. Memory, the
release phase and nice -20: bench/host.cpp. The Brain: numpy inverts matrices with its default number of threads, and
with one thread on the Brain's core; each with and without a program that spins like a Spine. A measurement that the
kernel does not permit, such as nice -20 without root, is left out, with the reason.
"""

import contextlib
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

from lithe.demo.processes import DIE_WITH_US
from lithe.place import THREAD_VARIABLES

from bench import report

Figures = dict[str, Any]
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


class Brain:
    """A process that computes for the time of a block on request."""

    def __init__(self, core: int | None) -> None:
        """With one thread on that core; or, without a core, with numpy's default threads on any core."""
        env = {name: value for name, value in os.environ.items() if name not in THREAD_VARIABLES}
        pinned = ["taskset", "-c", str(core)] if core is not None else []
        if core is not None:
            env |= dict.fromkeys(THREAD_VARIABLES, "1")
        words = [*DIE_WITH_US, *pinned, sys.executable, "-c", BRAIN, str(BLOCK_S)]
        self.process = subprocess.Popen(words, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.threads = int(self.answer())

    def answer(self) -> float:
        """Reads one line of its output."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise report.Unmeasured(f"numpy's process ended with {self.process.wait()}")
        return float(line)

    def rate(self) -> float:
        """Inversions per second in one block."""
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return self.answer()

    def close(self) -> None:
        """Ends it."""
        self.process.kill()
        self.process.communicate()


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
                rates.setdefault(f"{name}_alone", []).append(brain.rate())
            with spinning(spine):
                for name, brain in running.items():
                    rates.setdefault(f"{name}_beside", []).append(brain.rate())
        figures: Figures = {f"host_brain_{key}_per_s": statistics.median(each) for key, each in rates.items()}
        for name, brain in running.items():
            ratios = [a / b for a, b in zip(rates[f"{name}_alone"], rates[f"{name}_beside"], strict=True)]
            figures[f"host_brain_{name}_slower"] = statistics.median(ratios)
            figures[f"host_brain_{name}_slower_least"], figures[f"host_brain_{name}_slower_most"] = (
                min(ratios),
                max(ratios),
            )
            figures[f"host_brain_{name}_threads"] = brain.threads
        return figures
    finally:
        for brain in running.values():
            brain.close()


def main(words: list[str]) -> int:
    """Measure and show, or (`--figures`, for bench.report) measure and print one line."""
    if set(words) - {"--short", "--figures"}:
        print(__doc__, file=sys.stderr)
        return 2
    short = "--short" in words or bool(os.environ.get("LITHE_BENCH_SHORT"))
    if "--figures" not in words:
        if short:
            os.environ["LITHE_BENCH_SHORT"] = "1"
        return report.main(["host"])
    cores = report.cores()
    if not cores:
        print("bench: host needs bench_cores (make bench builds it) and two cores", file=sys.stderr)
        return 1
    try:
        figures = report.measure((*report.program("host"), "1" if short else "12"))
        figures |= brains(cores, 1 if short else ROUNDS)
    except report.Unmeasured as why:
        print(f"bench: {why}", file=sys.stderr)
        return 1
    print(json.dumps({"host_short": short} | figures))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
