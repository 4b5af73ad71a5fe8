# SPDX-License-Identifier: Apache-2.0
"""Interrupts on the Spine's core and loading time per swap, with the arena and with dlopen.

Swaps of a running robot alternate with pauses of the same length. The interrupts in the pauses come from the machine,
and are subtracted. Writes out/bench/swap_interrupts.json.
"""

import contextlib
import json
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bench.report import OUT, ROOT, Figures, machine
from bench.tables import table

BIN = Path(os.environ.get("LITHE_BIN_DIR", ROOT / "build/release/bin"))
LAWS = ("pd", "hold")
VARIANTS = 12  # more than stay resident: a resident one would already be loaded for dlopen
WARM_UP = 2 * VARIANTS  # after that every one is compiled, and the list of earlier laws is full
KINDS = ("TLB", "CAL")
START_S = 90.0


class Robot:
    """A running `lithe run`, and its control socket."""

    def __init__(self, run_dir: Path) -> None:
        """Connect, and find out on which core the Spine ticks."""
        self.link = socket.socket(socket.AF_UNIX)
        self.link.connect(str(run_dir / "arm.sock"))
        self.lines = self.link.makefile("rb")
        self.status = self.ask("status")
        self.cpu = int(self.status["cpus"]["spine"])

    def ask(self, verb: str, **args: Any) -> Any:
        """Sends one verb; returns its result."""
        self.link.sendall(json.dumps({"id": 1, "verb": verb, "args": args}).encode() + b"\n")
        answer = json.loads(self.lines.readline())
        if not answer["ok"]:
            sys.exit(f"bench: {verb}: {answer['error']['message']}")
        return answer["result"]

    def interrupts(self) -> list[int]:
        """Interrupts on the Spine's core so far, in the order of KINDS."""
        counts = {}
        for line in Path("/proc/interrupts").read_text().splitlines():
            name, _, rest = line.strip().partition(":")
            if name in KINDS:
                counts[name] = int(rest.split()[self.cpu])
        return [counts.get(kind, 0) for kind in KINDS]


@contextlib.contextmanager
def running(loader: str) -> Iterator[Robot]:
    """The desk arm with this loader."""
    with tempfile.TemporaryDirectory(prefix="lithe-") as name:
        folder = Path(name)
        text = (ROOT / "robots/arm.toml").read_text().replace('"../laws/', f'"{ROOT}/laws/')
        (folder / "arm.toml").write_text(text.replace('loader = "arena" ', f'loader = "{loader}" '))
        env = os.environ | {
            "LITHE_RUN_DIR": name,
            "LITHE_SHM_PREFIX": folder.name,
            "LITHE_OUT_DIR": f"{name}/out",
        }
        with (folder / "log").open("w") as log:
            process = subprocess.Popen(
                [BIN / "lithe", "run", folder / "arm.toml", "--no-arm"], env=env, stdout=log, stderr=log
            )
        try:
            end = time.monotonic() + START_S
            while not (folder / "arm.sock").exists():
                if process.poll() is not None or time.monotonic() > end:
                    sys.exit(f"bench: the robot does not start:\n{(folder / 'log').read_text()}")
                time.sleep(0.05)
            yield Robot(folder)
        finally:
            process.terminate()
            process.wait()


def mean_error(values: list[int]) -> float:
    """The standard error of a mean."""
    return float(statistics.stdev(values) / len(values) ** 0.5)


def measure(loader: str, swaps: int) -> Figures:
    """Figures of one loader; its name is the first part of each key."""
    with running(loader) as robot:
        if robot.status["loader"] != loader:
            sys.exit(f"bench: asked for {loader}, got {robot.status['loader']}: {robot.status['lost']}")
        os.sched_setaffinity(0, os.sched_getaffinity(0) - {robot.cpu} or {robot.cpu})
        sources = [(ROOT / f"laws/{LAWS[i % 2]}.cpp").read_text() + f"// {i}\n" for i in range(VARIANTS)]
        load_us: list[float] = []
        during: list[list[int]] = []
        pauses: list[list[int]] = []
        for i in range(WARM_UP + swaps):
            before, began_s = robot.interrupts(), time.monotonic()
            swap = robot.ask("swap", source=sources[i % VARIANTS], name=f"{LAWS[i % 2]}.cpp")
            time.sleep(0.003)  # time for retiring the old law
            middle, lasted_s = robot.interrupts(), time.monotonic() - began_s
            time.sleep(lasted_s)
            after = robot.interrupts()
            if i < WARM_UP:
                continue
            during.append([b - a for a, b in zip(before, middle, strict=True)])
            pauses.append([b - a for a, b in zip(middle, after, strict=True)])
            staged = [
                each["value"]
                for each in robot.ask("events")["events"]
                if each["kind"] == "law_staged" and each["request_id"] == swap["request_id"]
            ]
            load_us += [1e3 * value for value in staged]
    figures: Figures = {f"{loader}_swaps": swaps, f"{loader}_load_p50_us": statistics.median(load_us)}
    figures[f"{loader}_load_p95_us"] = statistics.quantiles(load_us, n=20)[-1]
    for k, kind in enumerate(KINDS):
        extra = [swap[k] - pause[k] for swap, pause in zip(during, pauses, strict=True)]
        key = f"{loader}_{kind.lower()}"
        figures[f"{key}_in_swaps"] = sum(each[k] for each in during)
        figures[f"{key}_in_pauses"] = sum(each[k] for each in pauses)
        figures[f"{key}_per_swap"] = statistics.mean(extra)
        figures[f"{key}_per_swap_error"] = mean_error(extra)
    return figures


def main() -> int:
    """Measure both, print them side by side."""
    swaps = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    figures = machine() | measure("dlopen", swaps) | measure("arena", swaps)
    rows = []
    for loader in ("dlopen", "arena"):
        cells = [f"{figures[f'{loader}_load_{q}_us']:.0f}" for q in ("p50", "p95")]
        for kind in KINDS:
            key = f"{loader}_{kind.lower()}"
            cells += [
                f"{figures[f'{key}_per_swap']:.2f} ± {figures[f'{key}_per_swap_error']:.2f}",
                f"{figures[f'{key}_in_swaps']} / {figures[f'{key}_in_pauses']}",
            ]
        rows.append([loader, *cells])
    head = ["", "load p50 [us]", "p95", "TLB per swap", "in swaps / pauses", "CAL per swap", "in swaps / pauses"]
    table(f"{swaps} swaps of a running robot, on the Spine's core", head, rows)
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "swap_interrupts.json").write_text(json.dumps(figures, indent=2) + "\n")
    print(f"\nall figures: {(OUT / 'swap_interrupts.json').relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
