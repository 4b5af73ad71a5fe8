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
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bench import report

ROOT = report.ROOT
CASES = 200
TOLERANCE = 1e-5  # of the values read: some codecs use floats, some doubles
Figures = dict[str, Any]


class Peer:
    """One codec: a program that writes and reads the cases, and is timed when asked."""

    def __init__(self, name: str, core: int, command: list[str], env: dict[str, str] | None = None) -> None:
        """Starts it on that core; its first line has the frames that it writes and the values that it reads."""
        self.name = name
        self.rounds: list[Figures] = []
        self.process = subprocess.Popen(
            ["taskset", "-c", str(core), *command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=env or dict(os.environ),
            cwd=ROOT,
        )
        self.told = self.answer()

    def answer(self) -> Figures:
        """Reads one line of JSON from it."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            self.close()
            raise report.Unmeasured(f"codec of {self.name} ended with {self.process.returncode}")
        told: Figures = json.loads(line)
        return told

    def ask(self) -> Figures:
        """The time of one pass over all cases."""
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return self.answer()

    def measure(self) -> None:
        """One turn: a pass that is not counted, because other codecs used the caches, and one that is."""
        self.ask()
        self.rounds.append(self.ask())

    def median(self, key: str) -> float:
        """The median of all rounds."""
        return statistics.median(float(each[key]) for each in self.rounds)

    def close(self) -> None:
        """Ends it."""
        with contextlib.suppress(OSError):
            self.process.communicate(timeout=20)


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
            raise report.Unmeasured(f"codec of {peer.name} against {reference.name}: {wrong}")
    for _ in range(rounds):
        for peer in running:
            peer.measure()
    figures: Figures = {"codec_frames": len(ours.told["frames"]), "codec_upstream_absent": "; ".join(absent)}
    for key in ("encode_ns", "parse_ns"):
        for peer in running:
            figures[f"codec_{peer.name}_{key}"] = peer.median(key)
            if peer is ours:
                continue
            ratios = [a[key] / b[key] for a, b in zip(peer.rounds, ours.rounds, strict=True)]
            figures[f"codec_{peer.name}_over_lithe_{key.removesuffix('_ns')}"] = statistics.median(ratios)
            figures[f"codec_{peer.name}_{key.removesuffix('_ns')}_spread"] = spread(ratios)
    return figures


def codecs(rounds: int) -> Figures:
    """The figures of the codecs; if there are none, the reason instead."""
    with tempfile.TemporaryDirectory(prefix="lithe-codec-") as folder:
        try:
            with peers(Path(folder)) as (running, absent):
                return compare(running, absent, rounds)
        except (OSError, report.Unmeasured) as why:
            return {"codec_absent": str(why)}


def main(words: list[str]) -> int:
    """Measure and show, or (`--figures`, for bench.report) measure and print one line."""
    if set(words) - {"--short", "--figures"}:
        print(__doc__, file=sys.stderr)
        return 2
    short = "--short" in words or bool(os.environ.get("LITHE_BENCH_SHORT"))
    if "--figures" not in words:
        if short:
            os.environ["LITHE_BENCH_SHORT"] = "1"
        return report.main(["scale"])
    exchange_rounds, spine_rounds, codec_rounds = (8, 1, 8) if short else (40, 6, 25)
    try:
        figures = report.measure((*report.program("scale"), str(exchange_rounds), str(spine_rounds)))
    except report.Unmeasured as why:
        print(f"bench: {why}", file=sys.stderr)
        return 1
    print(json.dumps({"scale_short": short} | figures | codecs(codec_rounds)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
