# SPDX-License-Identifier: Apache-2.0
"""Draws docs/img/timing.svg from one measured run: two ticks, and a swap while the arm moves.

python tools/timing_figure.py [--cached] [--robot robots/arm.toml] [--out docs/img/timing.svg]
    starts the robot, streams a sine, has laws/gravity_pd.cpp compiled and swapped in, draws what the telemetry says
    --cached: the law as it stands, so that a cache of an earlier run may have it compiled
"""

from __future__ import annotations

import argparse
import io
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "brain"))

import lithe  # noqa: E402  (before numpy: it keeps numpy off the Spine's core)
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
import numpy.typing as npt  # noqa: E402
from lithe._wire import TelemetryFlags  # noqa: E402
from lithe.demo.figures import BLUE, GREEN, GREY, ORANGE, PALE, RED, STYLE  # noqa: E402
from lithe.demo.processes import Stage, start_brain  # noqa: E402
from matplotlib.ticker import FuncFormatter  # noqa: E402

Records = npt.NDArray[Any]

VIOLET, SAND = "#8661c1", "#f6ecd9"
SMALL: dict[str, Any] = {"fontsize": 7.5, "color": GREY}
LOOK = STYLE | {"svg.fonttype": "none", "svg.hashsalt": "lithe", "legend.frameon": False, "legend.fontsize": 7.5}
SINE = {"centre_rad": 0.0, "amplitude_rad": 0.8, "frequency_hz": 0.5}
SETTLE_S, AFTER_S = 2.0, 0.6
MOST_MS = 800.0  # of a swap: more is cut off at its beginning, in the stages too
AROUND_MS = 12.0  # of the commit, in the last panel
STAGES = ("queued", "compiled", "admitted", "placed", "tried", "staged", "committed")
STAGE_COLOURS = dict(zip(STAGES, (PALE, ORANGE, VIOLET, BLUE, GREEN, GREY, RED), strict=True))


@dataclass
class Run:
    """What was measured: records that include the commit, and the swap's own account."""

    records: Records
    rate_hz: float
    inline: bool
    law_names: tuple[str, str]
    commit_tick: int
    split_ms: dict[str, float]
    machine: str

    @property
    def commit(self) -> int:
        """Index of the record of the commit's tick."""
        found = np.flatnonzero(self.records["tick"] == self.commit_tick)
        if len(found) != 1 or not 50 < found[0] < len(self.records) - 50:
            raise ValueError(f"the records do not reach around tick {self.commit_tick}, the commit: run it again")
        return int(found[0])


def typical(run: Run) -> int:
    """The first of two ticks in a row, before the swap, whose durations are nearest to the medians."""
    before = run.records[: run.commit - 20]
    names = ("tick_ns", "handoff_ns", "law_ns", "guard_ns", "bus_ns", "release_jitter_ns")
    far = sum(np.abs(np.log((before[n] + 10.0) / (np.median(before[n]) + 10.0))) for n in names)
    return int(np.argmin(far[1:-2] + far[2:-1] + far[3:])) + 1


def spans_of(run: Run, at: int, zero_ns: int) -> dict[str, tuple[float, float]]:
    """When the parts of one tick began and ended, in us after `zero_ns`. The tick's end is told by the next record."""
    now, after = run.records[at], run.records[at + 1]
    woke = (int(now["release_ns"]) + int(now["release_jitter_ns"]) - zero_ns) / 1e3
    handed = woke + int((after if run.inline else now)["handoff_ns"]) / 1e3
    return {
        "tick": (woke, woke + int(after["tick_ns"]) / 1e3),
        "bus": (handed, handed + int(after["bus_ns"]) / 1e3),
    }


def draw_two_ticks(axes: Any, run: Run, at: int) -> None:
    """Panel (a): to scale, so that one sees how much of a period is used."""
    period_us = 1e6 / run.rate_hz
    zero_ns = int(run.records["release_ns"][at])
    place = "in the slack of the tick thread" if run.inline else "on a thread of its own"
    axes.set_title(f"(a) Two ticks, to scale; the buses are served {place}")
    for number in range(3):
        axes.axvline(number * period_us, color=GREY, lw=0.8, ls=(0, (3, 3)), zorder=0)
        name = f" release k{'+' + str(number) if number else ''}"
        axes.text(number * period_us, 1.55, name, va="center", **SMALL)
    for row, (name, colour) in enumerate((("bus", ORANGE), ("tick", BLUE))):
        for number in range(2):
            start, end = spans_of(run, at + number, zero_ns)[name]
            axes.barh(row, end - start, 0.6, start, color=colour)
            axes.text(end, row, f" {end - start:.1f} µs", va="center", **SMALL)
    axes.set_yticks((0, 1), ("bus exchange", "Spine: tick"))
    axes.set_ylim(-0.5, 1.8)
    axes.set_xlim(-0.05 * period_us, 2.25 * period_us)
    axes.set_xlabel("µs after release k")


def draw_one_tick(axes: Any, run: Run, at: int) -> None:
    """Panel (b): the same tick, enlarged, as the durations that its records hold."""
    now, after = run.records[at], run.records[at + 1]
    whole_us = int(after["tick_ns"]) / 1e3
    parts = [("law", int(now["law_ns"]) / 1e3, GREEN), ("guard", int(now["guard_ns"]) / 1e3, VIOLET)]
    if not run.inline:
        parts.insert(0, ("hand u_k over, take x_k", int(now["handoff_ns"]) / 1e3, ORANGE))
    rest = whole_us - sum(length for _, length, _ in parts)
    parts.append(("exchange, commands, plan, telemetry" if run.inline else "commands, plan, telemetry", rest, PALE))
    axes.set_title(f"(b) What tick k spent its {whole_us:.2f} µs on (woken {now['release_jitter_ns']} ns late)")
    start = 0.0
    for name, length, colour in parts:
        axes.barh(0, length, 0.6, start, color=colour, label=f"{name} {length:.2f}")
        start += length
    axes.set_yticks((0,), ("tick k",))
    axes.set_ylim(-0.5, 1.2)
    axes.set_xlim(0, whole_us * 1.02)
    axes.legend(loc="upper left", ncols=len(parts), borderaxespad=0)
    axes.set_xlabel("µs; lengths to scale, their order is the tick's but for the last, which is several parts")


def draw_swap(axes: Any, run: Run) -> None:
    """Panel (c): from the request to the commit, and what every tick meanwhile was like."""
    lengths_ms = [run.split_ms.get(stage, 0.0) for stage in STAGES]
    shown_ms = min(sum(lengths_ms), MOST_MS)
    axes.set_title(f"(c) A swap: {sum(lengths_ms):.0f} ms from the request to the commit; each dot is a tick")
    start = -sum(lengths_ms)
    for stage, length in zip(STAGES, lengths_ms, strict=True):
        label = f"{stage} {length:.1f}"
        axes.axvspan(start, start + length, 0.9, 1.0, color=STAGE_COLOURS[stage], lw=0, label=label)
        start += length
    since_ms = (run.records["release_ns"] - run.records["release_ns"][run.commit]) / 1e6
    shown = (since_ms >= -1.12 * shown_ms) & (since_ms <= 0.15 * shown_ms)
    for name, colour, label in (
        ("tick_ns", BLUE, "duration of a tick"),
        ("release_jitter_ns", ORANGE, "release jitter"),
    ):
        values_us = np.maximum(run.records[name][shown], 10) / 1e3
        axes.plot(since_ms[shown], values_us, ".", ms=2.6, mew=0, color=colour, label=label)
    axes.axvline(0, color=RED, lw=0.9, ls=(0, (4, 3)))
    axes.text(0, 0.84, " commit", fontsize=8, color=RED, transform=axes.get_xaxis_transform())
    axes.set_yscale("log")
    axes.set_ylim(0.008, 40_000)
    axes.set_yticks(10.0 ** np.arange(-2, 4))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g} µs"))
    axes.minorticks_off()
    axes.set_xlim(-1.12 * shown_ms, 0.15 * shown_ms)
    axes.legend(loc="upper left", ncols=5, bbox_to_anchor=(0, 0.9), markerscale=4)
    axes.set_xlabel("ms after the commit")


def draw_commit(axes: Any, run: Run) -> None:
    """Panel (d): the torque around the commit."""
    since_ms = (run.records["release_ns"] - run.records["release_ns"][run.commit]) / 1e6
    near = (since_ms >= -AROUND_MS) & (since_ms <= 3 * AROUND_MS)
    axes.set_title("(d) Torque at the joint around the commit, one point a tick")
    blended = since_ms[near & (run.records["flags"] & TelemetryFlags.blending != 0)]
    if len(blended):
        axes.axvspan(blended[0], blended[-1], color=SAND, lw=0, label=f"blend: {np.ptp(blended):.1f} ms", zorder=0)
    ids = run.records["law_id"][near]
    for law_id, name, colour in zip((ids[0], ids[-1]), run.law_names, (GREY, GREEN), strict=True):
        mine = near & (run.records["law_id"] == law_id)
        torque_nm = run.records["command_torque_nm"][mine, 0]
        axes.plot(since_ms[mine], torque_nm, ".-", ms=3, lw=1.2, color=colour, label=f"{name} runs")
    axes.axvline(0, color=RED, lw=0.9, ls=(0, (4, 3)))
    axes.legend(loc="best")
    axes.set_ylabel("N m")
    axes.set_xlim(-AROUND_MS, 3 * AROUND_MS)
    axes.set_xlabel("ms after the commit")


def draw(run: Run) -> str:
    """The whole figure."""
    at = typical(run)
    with plt.rc_context(LOOK):
        heights = {"height_ratios": [0.9, 0.7, 1.8, 1.5]}
        figure, panels = plt.subplots(4, 1, figsize=(9.6, 8.4), layout="constrained", gridspec_kw=heights)
        draw_two_ticks(panels[0], run, at)
        draw_one_tick(panels[1], run, at)
        draw_swap(panels[2], run)
        draw_commit(panels[3], run)
        words = f"tick k is {run.records['tick'][at]}, the commit {run.commit_tick} · {run.machine}"
        figure.supxlabel(words, x=0.01, ha="left", **SMALL)
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None, "Title": "Two ticks and a swap, measured"})
        plt.close(figure)
    return text.getvalue()


def measure(robot_file: Path, cached: bool, say: Callable[[str], None]) -> Run:
    """Runs the robot and swaps once."""
    law = (ROOT / "laws/gravity_pd.cpp").read_text(encoding="utf-8")

    with tempfile.TemporaryDirectory() as out, Stage(robot_file, Path(out) / "run.log") as stage:
        say(f"{stage.robot} runs")
        start_brain(stage, Path(out) / "token", SINE)
        with lithe.connect(stage.robot, writes_plans=False) as robot:
            time.sleep(SETTLE_S)
            before = robot.status()["law"]
            fresh = "" if cached else f"// {time.time_ns()}: in no cache, so that it is compiled\n"
            swap = robot.swap(law + fresh, name="gravity_pd.cpp", params={"mgl_nm": 0.165})
            time.sleep(AFTER_S)
            records = robot.telemetry.history(3.5)
            info = robot.spine.info
            say(f"{before} replaced by {swap['law']} at tick {swap['commit_tick']}")
    cores = len({int(info[f"cpu_{role}"]) for role in ("spine", "transport", "brain", "housekeeping")})
    machine = f"{platform.machine()}, Linux {platform.release()}, {cores} of {os.cpu_count()} cores, "
    machine += f"load average {os.getloadavg()[0]:.1f}"
    split = {stage: float(swap["split_ms"].get(stage) or 0.0) for stage in STAGES}
    return Run(
        records,
        float(info["rate_hz"]),
        bool(info["transport_inline"]),
        (str(before), str(swap["law"])),
        int(swap["commit_tick"]),
        split,
        machine,
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cached", action="store_true")
    parser.add_argument("--robot", type=Path, default=ROOT / "robots/arm.toml")
    parser.add_argument("--out", type=Path, default=ROOT / "docs/img/timing.svg")
    args = parser.parse_args()
    try:
        figure = draw(measure(args.robot, args.cached, print))
    except (lithe.LitheError, ValueError) as error:
        print(f"timing_figure.py: {error}", file=sys.stderr)
        return 1
    args.out.write_text(figure, encoding="utf-8")
    print(f"wrote {args.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
