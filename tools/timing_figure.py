# SPDX-License-Identifier: Apache-2.0
"""Draws docs/img/timing.svg from one measured run: two ticks, and a swap while the arm moves.

python tools/timing_figure.py [--cached] [--robot robots/arm.toml] [--out docs/img/timing.svg]
    starts the robot, streams a sine, has laws/gravity_pd.cpp compiled and swapped in, draws what the telemetry says
    --cached: the law as it stands, so that a cache of an earlier run may have it compiled
"""

from __future__ import annotations

import argparse
import math
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "brain"))

import lithe  # noqa: E402  (before numpy: it keeps numpy off the Spine's core)
import numpy as np  # noqa: E402
import numpy.typing as npt  # noqa: E402
from lithe._wire import TelemetryFlags  # noqa: E402
from lithe.demo.processes import Stage, start_brain  # noqa: E402

Records = npt.NDArray[Any]

INK, GREY, PALE = "#24292f", "#6e7781", "#d0d7de"
BLUE, ORANGE, GREEN, VIOLET, RED = "#2f6fb7", "#d9822b", "#3f8f5f", "#8661c1", "#b3382c"
WIDTH, LEFT, RIGHT = 960, 130, 930
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


@dataclass
class Sheet:
    """An SVG that grows line by line. Coordinates are pixels, y downwards."""

    height: int
    lines: list[str] = field(default_factory=list)

    def box(self, x: float, y: float, width: float, height: float, colour: str, tip: str = "") -> None:
        title = f"<title>{escape(tip)}</title>" if tip else ""
        self.lines.append(
            f'<rect x="{x:.2f}" y="{y:.1f}" width="{max(width, 0.6):.2f}" height="{height:.1f}" fill="{colour}">'
            f"{title}</rect>"
        )

    def line(self, x1: float, y1: float, x2: float, y2: float, colour: str = PALE, dash: str = "") -> None:
        more = f' stroke-dasharray="{dash}"' if dash else ""
        self.lines.append(f'<line x1="{x1:.2f}" y1="{y1:.1f}" x2="{x2:.2f}" y2="{y2:.1f}" stroke="{colour}"{more}/>')

    def path(self, points: list[tuple[float, float]], colour: str) -> None:
        way = " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
        self.lines.append(f'<polyline points="{way}" fill="none" stroke="{colour}" stroke-width="1.5"/>')

    def dot(self, x: float, y: float, colour: str) -> None:
        self.lines.append(f'<circle cx="{x:.2f}" cy="{y:.2f}" r="1.4" fill="{colour}"/>')

    def text(self, x: float, y: float, words: str, look: str = "", anchor: str = "start") -> None:
        self.lines.append(f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {look}>{escape(words)}</text>')

    def svg(self, title: str) -> str:
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {self.height}" role="img" '
            f'font-family="sans-serif" font-size="12" fill="{INK}">\n'
            "<!-- Made by tools/timing_figure.py from a measured run. -->\n"
            f'<title>{escape(title)}</title>\n<rect width="{WIDTH}" height="{self.height}" fill="#ffffff"/>\n'
        )
        return head + "\n".join(self.lines) + "\n</svg>\n"


@dataclass
class Scale:
    """One axis: from a value to pixels."""

    least: float
    most: float
    low: float = LEFT
    high: float = RIGHT

    def __call__(self, value: float) -> float:
        share = (value - self.least) / (self.most - self.least)
        return self.low + min(max(share, 0.0), 1.0) * (self.high - self.low)


BOLD = 'font-weight="bold"'
SMALL = f'font-size="11" fill="{GREY}"'


def ticks_of(least: float, most: float) -> list[float]:
    """Round numbers for an axis, four to nine of them."""
    step = 10.0 ** math.floor(math.log10((most - least) / 4))
    step *= next(each for each in (5, 2, 1) if (most - least) / (step * each) >= 4)
    return [step * i for i in range(math.ceil(least / step), math.floor(most / step) + 1)]


def axis(sheet: Sheet, x: Scale, y: float, unit: str) -> None:
    """A time axis below a panel."""
    sheet.line(x.low, y, x.high, y, GREY)
    for value in ticks_of(x.least, x.most):
        sheet.line(x(value), y, x(value), y + 4, GREY)
        sheet.text(x(value), y + 16, f"{value:g}", SMALL, "middle")
    sheet.text(x.high, y + 30, unit, SMALL, "end")


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


def draw_two_ticks(sheet: Sheet, run: Run, at: int, top: float) -> None:
    """Panel (a): to scale, so that one sees how much of a period is used."""
    period_us = 1e6 / run.rate_hz
    zero_ns = int(run.records["release_ns"][at])
    x = Scale(-0.05 * period_us, 2.25 * period_us)
    place = "in the slack of the tick thread" if run.inline else "on a thread of its own"
    sheet.text(LEFT, top, f"(a) Two ticks, to scale; the buses are served {place}", BOLD)
    rows = {"tick": (top + 40, BLUE, "Spine: tick"), "bus": (top + 66, ORANGE, "bus exchange")}
    for number in range(3):
        due = x(number * period_us)
        sheet.line(due, top + 24, due, top + 90, GREY, "3 3")
        sheet.text(due + 3, top + 24, f"release k{'+' + str(number) if number else ''}", SMALL)
    for name, (y, _, label) in rows.items():
        sheet.text(LEFT - 8, y + 12, label, "", "end")
        sheet.line(LEFT, y + 16, RIGHT, y + 16)
        for number in range(2):
            start, end = spans_of(run, at + number, zero_ns)[name]
            tip = f"{name} of tick k+{number}: {start - number * period_us:.2f} to {end - number * period_us:.2f} µs"
            sheet.box(x(start), y, x(end) - x(start), 16, rows[name][1], tip)
            sheet.text(x(end) + 4, y + 12, f"{end - start:.1f} µs", SMALL)
    axis(sheet, x, top + 92, "µs after release k")


def draw_one_tick(sheet: Sheet, run: Run, at: int, top: float) -> None:
    """Panel (b): the same tick, enlarged, as the durations that its records hold."""
    now, after = run.records[at], run.records[at + 1]
    whole_us = int(after["tick_ns"]) / 1e3
    parts = [("law", int(now["law_ns"]) / 1e3, GREEN), ("guard", int(now["guard_ns"]) / 1e3, VIOLET)]
    if not run.inline:
        parts.insert(0, ("hand u_k over, take x_k", int(now["handoff_ns"]) / 1e3, ORANGE))
    rest = whole_us - sum(length for _, length, _ in parts)
    parts.append(("exchange, commands, plan, telemetry" if run.inline else "commands, plan, telemetry", rest, PALE))
    x = Scale(0.0, whole_us * 1.02)
    sheet.text(
        LEFT, top, f"(b) What tick k spent its {whole_us:.2f} µs on (woken {now['release_jitter_ns']} ns late)", BOLD
    )
    sheet.text(LEFT - 8, top + 32, "tick k", "", "end")
    start = 0.0
    for number, (name, length, colour) in enumerate(parts):
        sheet.box(x(start), top + 20, x(start + length) - x(start), 18, colour, f"{name}: {length:.2f} µs")
        sheet.box(LEFT + 195 * number, top + 48, 10, 10, colour)
        sheet.text(LEFT + 195 * number + 14, top + 57, f"{name} {length:.2f}", SMALL)
        start += length
    axis(sheet, x, top + 68, "µs; lengths to scale, their order is the tick's but for the last, which is several parts")


def draw_swap(sheet: Sheet, run: Run, top: float) -> None:
    """Panel (c): from the request to the commit, and what every tick meanwhile was like."""
    commit = run.commit
    asked_ms = -sum(run.split_ms.get(stage, 0.0) for stage in STAGES)
    shown_ms = min(-asked_ms, MOST_MS)
    x = Scale(-shown_ms * 1.12, shown_ms * 0.15)
    sheet.text(LEFT, top, f"(c) A swap: {-asked_ms:.0f} ms from the request to the commit; each dot is a tick", BOLD)
    sheet.text(LEFT - 8, top + 30, "stages", "", "end")
    start = asked_ms
    for number, stage in enumerate(STAGES):
        length = run.split_ms.get(stage, 0.0)
        sheet.box(
            x(start), top + 18, x(start + length) - x(start), 16, STAGE_COLOURS[stage], f"{stage}: {length:.2f} ms"
        )
        sheet.box(LEFT + 114 * number, top + 44, 10, 10, STAGE_COLOURS[stage])
        sheet.text(LEFT + 114 * number + 14, top + 53, f"{stage} {length:.1f}", SMALL)
        start += length
    y = Scale(-2.0, 3.3, top + 170, top + 66)  # decades of us
    for decade in range(-2, 4):
        sheet.line(LEFT, y(decade), RIGHT, y(decade))
        sheet.text(LEFT - 8, y(decade) + 4, f"{10.0**decade:g} µs", SMALL, "end")
    since_ms = (run.records["release_ns"] - run.records["release_ns"][commit]) / 1e6
    for i in np.flatnonzero((since_ms >= x.least) & (since_ms <= x.most)):
        for name, colour in (("tick_ns", BLUE), ("release_jitter_ns", ORANGE)):
            value_us = max(float(run.records[name][i]), 10.0) / 1e3
            sheet.dot(x(float(since_ms[i])), y(math.log10(value_us)), colour)
    sheet.line(x(0), top + 60, x(0), top + 170, RED, "4 3")
    sheet.text(x(0) + 4, top + 30, "commit", f'fill="{RED}"')
    sheet.dot(RIGHT - 250, top - 4, BLUE)
    sheet.text(RIGHT - 244, top, "duration of a tick", SMALL)
    sheet.dot(RIGHT - 120, top - 4, ORANGE)
    sheet.text(RIGHT - 114, top, "release jitter", SMALL)
    axis(sheet, x, top + 172, "ms after the commit")


def draw_commit(sheet: Sheet, run: Run, top: float) -> None:
    """Panel (d): the torque around the commit."""
    commit = run.commit
    since_ms = (run.records["release_ns"] - run.records["release_ns"][commit]) / 1e6
    near = np.flatnonzero(np.abs(since_ms) <= 3 * AROUND_MS)
    torque_nm = run.records["command_torque_nm"][near, 0]
    margin = 0.1 * max(float(np.ptp(torque_nm)), 1e-3)
    x = Scale(-AROUND_MS, 3 * AROUND_MS)
    y = Scale(float(torque_nm.min()) - margin, float(torque_nm.max()) + margin, top + 110, top + 16)
    sheet.text(LEFT, top, "(d) Torque at the joint around the commit, one point a tick", BOLD)
    blended = [i for i in near if int(run.records["flags"][i]) & TelemetryFlags.blending]
    if blended:
        first, last = float(since_ms[blended[0]]), float(since_ms[blended[-1]])
        sheet.box(x(first), top + 16, x(last) - x(first), 94, "#f6ecd9", f"blend: {last - first:.1f} ms")
        sheet.text((x(first) + x(last)) / 2, top + 28, "blend", SMALL, "middle")
    for value in ticks_of(y.least, y.most):
        sheet.line(LEFT, y(value), RIGHT, y(value))
        sheet.text(LEFT - 8, y(value) + 4, f"{value:g} N m", SMALL, "end")
    ids = run.records["law_id"][near]
    for law_id, colour in ((ids[0], GREY), (ids[-1], GREEN)):
        mine = [i for i in near if run.records["law_id"][i] == law_id and x.least <= since_ms[i] <= x.most]
        points = [(x(float(since_ms[i])), y(float(run.records["command_torque_nm"][i, 0]))) for i in mine]
        sheet.path(points, colour)
        for px, py in points:
            sheet.dot(px, py, colour)
    sheet.line(x(0), top + 12, x(0), top + 110, RED, "4 3")
    for number, (name, colour) in enumerate(zip(run.law_names, (GREY, GREEN), strict=True)):
        sheet.dot(RIGHT - 250 + 130 * number, top - 4, colour)
        sheet.text(RIGHT - 244 + 130 * number, top, f"{name} runs", SMALL)
    axis(sheet, x, top + 112, "ms after the commit")


def draw(run: Run) -> str:
    """The whole figure."""
    at = typical(run)
    sheet = Sheet(height=690)
    draw_two_ticks(sheet, run, at, 24)
    draw_one_tick(sheet, run, at, 172)
    draw_swap(sheet, run, 296)
    draw_commit(sheet, run, 524)
    sheet.text(LEFT, 682, f"tick k is {run.records['tick'][at]}, the commit {run.commit_tick} · {run.machine}", SMALL)
    return sheet.svg("Two ticks and a swap, measured")


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
