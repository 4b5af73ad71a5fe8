# SPDX-License-Identifier: Apache-2.0
"""The effect of a swap on the motion: PI with one low-pass replaced by PI with two, at full speed, warm and cold.

`python -m bench.swap.continuity [--figure PATH]` -> out/bench/continuity.json, a figure and a table; `make bench-swap`
runs it too. The integral compensates the arm's weight in both laws. Four ways: state carried and initialised from the
past, or from defaults; output blended, or not. The slew bound is always set very high: else it would hide the step.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lithe
import numpy as np
import numpy.typing as npt
from lithe._wire import TelemetryFlags
from lithe.programs import ROOT

from bench import report
from bench.swap.robot import WIDE_NM_S, Mover, running, wake
from bench.tables import Figures, cell, table

OLD, NEW = ROOT / "bench/swap/laws/pi_lowpass.cpp", ROOT / "bench/swap/laws/pi_two_pole.cpp"
SINE = {"centre_rad": 1.2, "amplitude_rad": 0.8, "frequency_hz": 1.0}
BLEND_S = 0.02
LEAST_SPEED_RAD_S = 4.5  # the largest speed of the sine is 5
SETTLE_S = 1.5
LOOK_S = 0.1  # longer than the log waits for new ticks
STEP_TICKS = 50  # after the commit: the blend, and the transient of a filter that starts from defaults
ERROR_TICKS = 300  # after the commit, and as many one period of the sine earlier
PERIOD_TICKS = 1000
REPEATS = 6
TRIES = 3  # for each repeat: disturbed swaps are not counted
LEAST_RATIO = 10.0  # a cold swap's step over LITHE's


@dataclass(frozen=True)
class Way:
    """One way to replace the law."""

    key: str
    words: str
    carried: bool
    blend_s: float


WAYS = (
    Way("lithe", "LITHE: state carried, init(past), blended", True, BLEND_S),
    Way("no_blend", "state carried, init(past)", True, 0.0),
    Way("no_state", "blended", False, BLEND_S),
    Way("cold", "cold: defaults, no blend", False, 0.0),
)


def without_a_past(source: str) -> str:
    """The same law with other names of its State fields, so that nothing is carried, and without init()."""
    return source.replace("integral_nm", "fresh_integral_nm").replace("static void init(", "static void not_called(")


@dataclass
class Crossing:
    """The ticks around one commit, which is at index `at`."""

    ticks: npt.NDArray[Any]
    at: int

    def steps_nm(self, since: int, ticks: int) -> float:
        """Largest change of the torque from one tick to the next."""
        part = self.ticks["torque_nm"][self.at + since : self.at + since + ticks + 1]
        return float(np.abs(np.diff(part)).max())

    def error_deg(self, since: int, ticks: int) -> npt.NDArray[np.float64]:
        """Setpoint minus position."""
        part: Any = self.ticks[self.at + since : self.at + since + ticks]
        error: npt.NDArray[np.float64] = np.degrees(part["setpoint_position_rad"] - part["position_rad"])
        return error

    def error_added_deg(self) -> float:
        """Largest difference from the error one period earlier, with the old law."""
        return float(np.abs(self.error_deg(0, ERROR_TICKS) - self.error_deg(-PERIOD_TICKS, ERROR_TICKS)).max())

    def speed_rad_s(self) -> float:
        """At the commit, over 20 ms."""
        ends = self.ticks[[self.at - 10, self.at + 10]]
        return float(np.diff(ends["position_rad"])[0] / (np.diff(ends["release_ns"])[0] * 1e-9))


class Experiment(Mover):
    """A robot on a sine, and swaps at its largest speed."""

    def __init__(self, robot: lithe.Robot) -> None:
        super().__init__(robot, SINE)
        self._commit_after_s = 0.01

    def _wait_for_full_speed(self) -> None:
        period_s = 1.0 / SINE["frequency_hz"]
        time.sleep(period_s - (time.monotonic() + self._commit_after_s) % period_s)

    def cross(self, old: str, new: str) -> Crossing | None:
        """From one law to the other at full speed; None when the machine disturbed it, or the commit was too late."""
        wake(self.robot)
        self.robot.swap(old, name="old.cpp")
        time.sleep(SETTLE_S)
        self._wait_for_full_speed()
        asked_ns = time.monotonic_ns()
        record = self.robot.swap(new, name="new.cpp")
        self._commit_after_s = (record["times_ns"]["committed"] - asked_ns) * 1e-9
        time.sleep(ERROR_TICKS * 1e-3 + 2 * LOOK_S)
        ticks = self.log.ticks()
        at = int(np.searchsorted(ticks["tick"], int(record["commit_tick"])))
        around = ticks[at - PERIOD_TICKS : at + ERROR_TICKS]
        if len(around) < PERIOD_TICKS + ERROR_TICKS:
            return None
        near = around[PERIOD_TICKS - STEP_TICKS :]
        disturbed = np.any(near["flags"] & TelemetryFlags.sample_stale) or np.ptp(near["missed_releases"]) > 0
        crossing = Crossing(around, PERIOD_TICKS)
        slow = crossing.speed_rad_s() < LEAST_SPEED_RAD_S  # the commit came late
        return None if disturbed or slow or not around["active"].all() else crossing


def cross_all(folder: Path, blend_s: float, repeats: int) -> dict[str, list[Crossing]]:
    """One robot; all ways with this blend, taking turns."""
    ways = [way for way in WAYS if way.blend_s == blend_s]
    old, new = OLD.read_text(encoding="utf-8"), NEW.read_text(encoding="utf-8")
    texts = {way.key: new if way.carried else without_a_past(new) for way in ways}
    found: dict[str, list[Crossing]] = {way.key: [] for way in ways}
    folder.mkdir(parents=True)
    # A cold swap fails its probation: here it must be measured to its end, and not be rolled back.
    with running(folder, torque_slew_nm_s=WIDE_NM_S, blend_s=str(blend_s), probation_error_ratio="0.0") as robot:
        for text in texts.values():
            robot.swap(text, name="new.cpp")  # compiled now; later it comes from the cache
        experiment = Experiment(robot)
        try:
            for _ in range(TRIES * repeats):
                for way in ways:
                    if len(found[way.key]) < repeats and (crossing := experiment.cross(old, texts[way.key])):
                        found[way.key].append(crossing)
        finally:
            experiment.stop()
    return found


def figures(crossings: dict[str, list[Crossing]]) -> Figures:
    """Medians over the repeats of every way."""
    told: Figures = {}
    for key, found in crossings.items():
        values = {
            "step_nm": [each.steps_nm(0, STEP_TICKS) for each in found],
            "step_before_nm": [each.steps_nm(-STEP_TICKS, STEP_TICKS) for each in found],
            "error_deg": [float(np.abs(each.error_deg(0, ERROR_TICKS)).max()) for each in found],
            "error_before_deg": [float(np.abs(each.error_deg(-PERIOD_TICKS, ERROR_TICKS)).max()) for each in found],
            "error_added_deg": [each.error_added_deg() for each in found],
            "speed_rad_s": [each.speed_rad_s() for each in found],
        }
        told |= {f"continuity_{key}_{name}": float(np.median(v)) if v else None for name, v in values.items()}
        told[f"continuity_{key}_step_worst_nm"] = max(values["step_nm"], default=None)
        told[f"continuity_{key}_swaps"] = len(found)
    cold, warm = told["continuity_cold_step_nm"], told["continuity_lithe_step_nm"]
    told["continuity_step_ratio"] = cold / warm if cold and warm else None
    return told


def draw(crossings: dict[str, list[Crossing]], path: Path) -> None:
    """Torque and tracking error around the commit, cold and with LITHE side by side."""
    from lithe.demo.figures import BLUE, GREY, INK, RED, STYLE  # chooses a backend without a display
    from matplotlib import pyplot as plt

    columns = (("cold", "(a) Cold: defaults, no blend", RED), ("lithe", "(b) LITHE: carried, init, blended", BLUE))
    with plt.rc_context(STYLE):
        figure, panels = plt.subplots(2, 2, figsize=(9.6, 5.0), layout="constrained", sharex=True, sharey="row")
        for column, (key, title, colour) in enumerate(columns):
            for each in crossings[key]:
                ticks: Any = each.ticks  # mypy takes seconds for the types of what follows
                since_ms = (ticks["release_ns"] - ticks["release_ns"][each.at]) * 1e-6
                near = (since_ms > -50) & (since_ms < 250)
                error_deg = np.degrees(ticks["setpoint_position_rad"] - ticks["position_rad"])
                panels[0, column].plot(since_ms[near], ticks["torque_nm"][near], color=colour, lw=0.9, alpha=0.7)
                panels[1, column].plot(since_ms[near], error_deg[near], color=colour, lw=0.9, alpha=0.7)
            panels[0, column].set_title(title)
            panels[1, column].set_xlabel("ms since the commit")
            for axes in panels[:, column]:
                axes.axvline(0, color=GREY, lw=0.8, ls=(0, (2, 2)))
        panels[0, 0].set_ylabel("torque [N m]", color=INK)
        panels[1, 0].set_ylabel("tracking error [deg]", color=INK)
        figure.savefig(path, dpi=150)
        plt.close(figure)


def measure(out: Path, repeats: int = REPEATS) -> Figures:
    """Both robots, all four ways; the figure is `out`/continuity.png."""
    shutil.rmtree(out / "continuity", ignore_errors=True)
    crossings: dict[str, list[Crossing]] = {}
    for blend_s in (BLEND_S, 0.0):
        crossings |= cross_all(out / "continuity" / f"blend_{blend_s}", blend_s, repeats)
    if all(crossings[key] for key in ("lithe", "cold")):
        draw(crossings, out / "continuity.png")
    return figures(crossings)


def show(told: Figures) -> None:
    """The table."""
    rows = [
        [
            way.words,
            cell(told, f"continuity_{way.key}_swaps", ".0f"),
            cell(told, f"continuity_{way.key}_step_nm", ".4f"),
            cell(told, f"continuity_{way.key}_step_worst_nm", ".4f"),
            cell(told, f"continuity_{way.key}_step_before_nm", ".4f"),
            cell(told, f"continuity_{way.key}_error_deg"),
            cell(told, f"continuity_{way.key}_error_before_deg"),
            cell(told, f"continuity_{way.key}_error_added_deg"),
        ]
        for way in WAYS
    ]
    head = ["", "swaps", "step [Nm]", "worst", "before", "error [deg]", "one period before", "added"]
    speed = cell(told, "continuity_lithe_speed_rad_s", ".1f")
    title = f"PI with one low-pass replaced by PI with two at {speed} rad/s, slew bound set very high (medians)"
    table(title, head, rows)
    print(f"  largest torque step from tick to tick within {STEP_TICKS} ms of the commit: ", end="")
    print(f"with a cold swap {cell(told, 'continuity_step_ratio', '.1f')} times that of LITHE")


def main(words: list[str]) -> int:
    """Measure, draw, write, print."""
    parser = argparse.ArgumentParser(prog="python -m bench.swap.continuity", description=__doc__)
    parser.add_argument("--repeats", type=int, default=REPEATS, help=f"swaps of each way (default {REPEATS})")
    parser.add_argument("--figure", type=Path, help="another place for the figure, for instance docs/img")
    asked = parser.parse_args(words)
    report.OUT.mkdir(parents=True, exist_ok=True)
    told = report.machine() | measure(report.OUT, asked.repeats)
    (report.OUT / "continuity.json").write_text(json.dumps(told, indent=2) + "\n")
    if asked.figure:
        shutil.copy(report.OUT / "continuity.png", asked.figure)
    show(told)
    ratio = told["continuity_step_ratio"]
    return 0 if ratio is not None and ratio >= LEAST_RATIO else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
