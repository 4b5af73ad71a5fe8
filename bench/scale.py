# SPDX-License-Identifier: Apache-2.0
"""The time that 1, 4, 12 and 32 joints take, and our moteus codec compared with others.

`python -m bench.scale [--short]` -> out/bench/scale.json and a table; `--short` runs few rounds (LITHE_BENCH_SHORT=1
does the same). Exchanges and ticks: bench/scale.cpp. Codecs: ours in C++ and the maker's Python
library (PyPI) write and read the same frames in turns; the bytes are compared. LITHE_CODEC_PEER can name a third
program with the interface of bench_codec (defined in bench/codec_cases.py), for example with the maker's
C++ library. All of them run on the core where the Spine would tick. Each turn begins with a pass that is not counted:
it brings the codec back into the caches.
"""

import contextlib
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench import report
from bench.asked import Asked, bench_of_its_own
from bench.report import ROOT
from bench.tables import Figures

CASES = 200
TOLERANCE = 1e-5  # of the values read: some codecs use floats, some doubles


class Peer(Asked):
    """One codec: it writes and reads the cases, and is timed when asked; `told` is what it wrote and read."""

    def __init__(self, name: str, core: int, words: list[str], env: dict[str, str] | None = None) -> None:
        """Starts it on that core."""
        super().__init__(f"codec of {name}", ["taskset", "-c", str(core), *words], env)
        self.key = f"codec_{name}"
        self.rounds: list[Figures] = []

    def measure(self) -> None:
        """One turn: a pass that is not counted, because other codecs used the caches, and one that is."""
        self.ask()
        self.rounds.append(self.ask())


def core_of_the_spine() -> int:
    """As bench/rig/machine.cpp selects it; if there are no two cores, the last one that this process may use."""
    return int(report.cores().get("machine_spine_core", max(os.sched_getaffinity(0))))


@contextlib.contextmanager
def peers(folder: Path) -> Iterator[tuple[list[Peer], list[str]]]:
    """All codecs that are available here, the maker's first, ours second; and why others are not."""
    cases = folder / "cases.jsonl"
    got = subprocess.run(
        [sys.executable, "tools/pypi.py", "moteus==1.0.0"], cwd=ROOT, check=False, capture_output=True, text=True
    )
    if got.returncode != 0:
        raise report.Unmeasured(got.stderr.strip())
    env = os.environ | {"PYTHONPATH": got.stdout.strip()}
    core = core_of_the_spine()
    running: list[Peer] = []
    absent = []
    try:
        running.append(Peer("python", core, [sys.executable, "bench/codec_cases.py", str(cases), str(CASES)], env))
        running.append(Peer("lithe", core, [*report.program("codec"), str(cases)]))
        if program := os.environ.get("LITHE_CODEC_PEER"):
            running.append(Peer("upstream", core, [program, str(cases)]))
        else:
            absent.append("LITHE_CODEC_PEER names no program")
        yield running, absent
    finally:
        for peer in running:
            peer.close()


def differences(theirs: Figures, ours: Figures) -> str:
    """The difference between two codecs in written bytes or read values; empty when there is none."""
    if theirs["frames"] != ours["frames"]:
        return "they write different frames"
    for expected, read in zip(theirs["reads"], ours["reads"], strict=True):
        if any(abs(a - b) > TOLERANCE * max(1.0, abs(a)) for a, b in zip(expected, read, strict=True)):
            return "they read different numbers"
    return ""


def spread(ratios: list[float]) -> float:
    """The interquartile range of the rounds, as a share of the median."""
    low, middle, high = statistics.quantiles(ratios, n=4)
    return (high - low) / middle


def compare(running: list[Peer], absent: list[str], rounds: int) -> Figures:
    """Nanoseconds per frame of each codec, in turns, and the ratio of the others to ours."""
    reference, ours = running[0], running[1]
    for peer in running[1:]:
        if wrong := differences(reference.told, peer.told):
            raise report.Unmeasured(f"{peer.name} against {reference.name}: {wrong}")
    for _ in range(rounds):
        for peer in running:
            peer.measure()
    told: Figures = {"codec_frames": len(ours.told["frames"]), "codec_upstream_absent": "; ".join(absent)}
    for part in ("encode", "parse"):
        times = {peer.key: [each[f"{part}_ns"] for each in peer.rounds] for peer in running}
        told |= {f"{key}_{part}_ns": statistics.median(each) for key, each in times.items()}
        mine = times.pop(ours.key)
        for key, theirs in times.items():
            ratios = [a / b for a, b in zip(theirs, mine, strict=True)]
            told |= {f"{key}_over_lithe_{part}": statistics.median(ratios), f"{key}_{part}_spread": spread(ratios)}
    return told


def codecs(rounds: int) -> Figures:
    """The figures of the codecs; if there are none, the reason instead."""
    with tempfile.TemporaryDirectory(prefix="lithe-codec-") as folder:
        try:
            with peers(Path(folder)) as (running, absent):
                return compare(running, absent, rounds)
        except (OSError, report.Unmeasured) as why:
            return {"codec_absent": str(why)}


def figures(short: bool) -> Figures:
    """All of them."""
    exchange_rounds, spine_rounds, codec_rounds = (8, 1, 8) if short else (40, 6, 25)
    told = report.measure((*report.program("scale"), str(exchange_rounds), str(spine_rounds)))
    return told | codecs(codec_rounds)


def main(words: list[str]) -> int:
    """Measure and show."""
    return bench_of_its_own("scale", words, __doc__ or "", figures)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
