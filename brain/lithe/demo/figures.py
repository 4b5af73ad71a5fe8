# SPDX-License-Identifier: Apache-2.0
"""The two figures of the experiment: distributions of the timing, and the run as four rows over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")  # no display needed

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.ticker import FuncFormatter

from . import losses
from .joints import error_deg
from .judge import Story

INK, GREY, PALE = "#24292f", "#6e7781", "#d0d7de"
BLUE, ORANGE, GREEN, RED = "#2f6fb7", "#d9822b", "#3f8f5f", "#b3382c"
FREEZE = "#a9c4e6"
LEAST_DEG = 0.001  # of what an axis shows of an error
PHASE_COLOURS = {
    "baseline": "#eccfca", "probing": "#f4e3bd", "gravity_only": "#dfe8c9", "evolving": "#e4dcf0", "evolved": "#cfe6d4",
    "frozen": FREEZE, "resumed": "#cfe6d4", "killed": FREEZE, "reattached": "#cfe6d4",
}  # fmt: skip
PHASE_WORDS = {
    "gravity_only": "gravity\nonly",
    "frozen": "Brain\nfrozen", "killed": "Brain\nkilled", "resumed": "evolved", "reattached": "evolved,\nnew Brain",
}  # fmt: skip
STYLE = {
    "font.size": 9, "axes.spines.top": False, "axes.spines.right": False,
    "axes.edgecolor": GREY, "axes.labelcolor": INK,
    "xtick.color": GREY, "ytick.color": GREY, "text.color": INK, "axes.titlesize": 10, "axes.titleweight": "bold",
    "axes.titlelocation": "left",
}  # fmt: skip


def _us(value: float) -> str:
    """Microseconds for people: three figures, no exponent."""
    return f"{value:,.0f} µs" if value >= 100 else f"{value:.3g} µs"


def plain_numbers(axis: Any) -> None:
    """0.01, 0.1, 1, 10 on a logarithmic axis."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))


def _counts_by_nanosecond(values_ns: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Log-spaced bins with borders between whole nanoseconds, so that no bin is empty for want of resolution."""
    top = max(float(values_ns.max()), 100.0)
    edges = np.unique(np.floor(np.logspace(0, np.log10(top) + 0.05, 90))) - 0.5
    counts, _ = np.histogram(np.maximum(values_ns, 1), edges)
    return counts, edges / 1e3


def distributions(records: npt.NDArray[Any], late_ns: npt.NDArray[Any], summary: dict[str, Any], path: Path) -> None:
    """Histograms of hand-off time and release jitter, with the quantiles that matter marked."""
    figure, panels = plt.subplots(1, 2, figsize=(9.6, 3.6), layout="constrained", sharey=True)
    for axes, key, values_ns, title, colour in (
        (panels[0], "handoff_us", records["handoff_ns"], "(a) Hand-off time", BLUE),
        (panels[1], "release_jitter_us", late_ns, "(b) Release jitter, skipped releases too", GREEN),
    ):
        counts, edges = _counts_by_nanosecond(values_ns)
        axes.stairs(counts, edges, fill=True, color=colour, alpha=0.75)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(0.7, None)
        for label, name, style in (
            ("p50", "p50", "-"),
            ("p99", "p99", "--"),
            ("p999", "p99.9", "-."),
            ("max", "max", ":"),
        ):
            value = float(summary[key][label])
            line_colour = RED if label == "max" else INK
            axes.axvline(max(value, edges[0]), color=line_colour, lw=1.1, ls=style, label=f"{name}  {_us(value)}")
        axes.axvline(1e6 / summary["rate_hz"], color=PALE, lw=4, zorder=0)
        axes.annotate(
            "one tick", (1e6 / summary["rate_hz"], 1.0), xytext=(-3, 4), textcoords="offset points",
            ha="right", fontsize=7, color=GREY, rotation=90,
        )  # fmt: skip
        axes.legend(facecolor="white", edgecolor="none", framealpha=0.9, fontsize=8, loc="upper right")
        plain_numbers(axes.xaxis)
        plain_numbers(axes.yaxis)
        axes.set_title(title)
        axes.set_xlabel("µs")
    panels[0].set_ylabel("ticks")
    machine = summary["machine"]
    words = f"{summary['ticks']:,} ticks · {machine['cpu']} · Linux {machine['kernel']}"
    figure.suptitle(words + (" · virtual machine" if machine["hypervisor"] else ""), fontsize=8, color=GREY)
    figure.savefig(path, dpi=160)
    plt.close(figure)


class _Timeline:
    """Four rows that share one time axis; second 0 is the first record."""

    def __init__(self, records: npt.NDArray[Any], story: Story, summary: dict[str, Any]) -> None:
        self.records, self.story, self.summary = records, story, summary
        self.zero_ns = int(records["release_ns"][0])
        self.t_s = (records["release_ns"] - self.zero_ns) * 1e-9
        self.figure, rows = plt.subplots(
            4,
            1,
            figsize=(10.5, 7.6),
            sharex=True,
            layout="constrained",
            gridspec_kw={"height_ratios": [0.9, 1, 1, 2.3]},
        )
        self.rows = list(rows)

    def second(self, t_ns: float) -> float:
        return (t_ns - self.zero_ns) * 1e-9

    def commit_s(self, swap: dict[str, Any]) -> float:
        return float(np.interp(swap["commit_tick"], self.records["tick"].astype(float), self.t_s))

    def phases(self) -> None:
        axes = self.rows[0]
        for phase in self.story.phases:
            left, right = self.second(phase["from_ns"]), self.second(phase["to_ns"])
            axes.axvspan(left, right, ymin=0.5, color=PHASE_COLOURS.get(phase["name"], PALE), lw=0)
            word = PHASE_WORDS.get(phase["name"], phase["name"])
            axes.text((left + right) / 2, 0.75, word, ha="center", va="center", fontsize=8, linespacing=0.95)
        for swap in self.story.swaps:
            left, right = self.second(swap["sent_ns"]), self.commit_s(swap)
            axes.barh(0.28, right - left, left=left, height=0.2, color=RED, alpha=0.8, lw=0)
            axes.text(left, 0.06, swap["law"], ha="left", va="center", fontsize=7.5, color=BLUE,
                      bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8})  # fmt: skip
        axes.text(0, 0.28, "compile and load ", ha="right", va="center", fontsize=7.5, color=RED,
                  transform=axes.get_yaxis_transform())  # fmt: skip
        axes.set_ylim(0, 1)
        axes.set_yticks([])
        axes.spines["left"].set_visible(False)
        axes.set_title("(a) What the agent does")

    def timing(self, axes: Any, at_ns: Any, values_ns: Any, key: str, title: str, colour: str) -> None:
        values_us = np.maximum(values_ns, 1) / 1e3
        axes.plot((at_ns - self.zero_ns) * 1e-9, values_us, ".", ms=1.6, mew=0, color=colour, rasterized=True)
        axes.set_yscale("log")
        axes.set_ylabel("µs")
        axes.set_ylim(min(0.5 * float(values_us.min()), 0.01), max(3 * float(values_us.max()), 10.0))
        q = self.summary[key]
        axes.set_title(f"{title}: p50 {_us(q['p50'])}, p99.9 {_us(q['p999'])}, max {_us(q['max'])}")
        plain_numbers(axes.yaxis)

    def tracking(self) -> None:
        """The setpoint and the arm; of several joints the error of each."""
        heavy = [number for number, joint in enumerate(self.summary["joints"]) if joint["bears_gravity"]]
        self.angles(heavy[0]) if len(heavy) == 1 else self.errors(heavy)
        axes = self.rows[3]
        rmse = {phase["name"]: phase["rmse_deg"] for phase in self.summary["phases"]}
        for phase in self.story.phases:
            if phase["name"] in ("baseline", "gravity_only", "evolved", "resumed", "reattached"):
                middle = self.second((phase["from_ns"] + phase["to_ns"]) / 2)
                axes.text(middle, 0.985, f"RMSE\n{rmse[phase['name']]:.2f}°", transform=axes.get_xaxis_transform(),
                          ha="center", va="top", fontsize=8)  # fmt: skip
        freeze = self.summary["freeze"]
        alone = f"holds at {freeze['rest_angle_deg']:.0f}°,\n{freeze['gravity_share']:.0%} of the\nlargest load"
        axes.text(
            self.second(self.story.freeze_ns[0]) + 0.1, 0.03,
            alone if len(heavy) == 1 else f"each holds\n≥ {freeze['gravity_share']:.0%} of its\nlargest load",
            transform=axes.get_xaxis_transform(), va="bottom", fontsize=7.5,
        )  # fmt: skip
        axes.set_xlabel("seconds")

    def errors(self, joints: list[int]) -> None:
        """One line a joint, on a logarithmic axis: the root mean square of its error over a quarter of a second."""
        axes = self.rows[3]
        width = max(1, round(0.25 * self.summary["rate_hz"]))
        starts = np.arange(0, len(self.t_s), width)
        colours = plt.get_cmap("turbo")(np.linspace(0.05, 0.95, len(joints)))
        for joint, colour in zip(joints, colours, strict=True):
            squares = np.add.reduceat(error_deg(self.records, joint) ** 2, starts)
            error = np.sqrt(squares / np.diff(np.append(starts, len(self.t_s))))
            name = self.summary["joints"][joint]["name"]
            axes.plot(self.t_s[starts], np.maximum(error, LEAST_DEG), color=colour, lw=1.1, label=name)
        axes.set_yscale("log")
        columns = 5 if len(joints) <= 15 else 8
        axes.set_ylim(LEAST_DEG / 10 ** -(-len(joints) // columns), 2000)  # room for words below and above the lines
        axes.set_yticks(LEAST_DEG * 10.0 ** np.arange(7))
        axes.minorticks_off()
        plain_numbers(axes.yaxis)
        axes.set_ylabel("degrees off the setpoint")
        axes.legend(loc="lower left", fontsize=7.5, frameon=False, ncols=columns)
        axes.set_title("(d) Tracking of each joint that bears gravity")

    def angles(self, joint: int) -> None:
        axes = self.rows[3]
        setpoint, arm = (np.degrees(self.records[name][:, joint]) for name in ("setpoint_position_rad", "position_rad"))
        axes.plot(self.t_s, setpoint, color="#aeb6bf", lw=3.2, label="setpoint", solid_capstyle="round")
        axes.plot(self.t_s, arm, color=ORANGE, lw=1.2, label="arm")
        axes.set_ylim(
            min(float(arm.min()), float(setpoint.min())) - 12, max(float(arm.max()), float(setpoint.max())) + 34
        )
        axes.set_ylabel("degrees")
        axes.legend(loc="lower left", fontsize=8, frameon=False, ncols=2)
        axes.set_title("(d) Tracking; hanging down is 0°, horizontal 90°")

    def marks(self) -> None:
        for axes in self.rows:
            for swap in self.summary["swaps"]:
                axes.axvline(self.commit_s(swap), color=BLUE, lw=1, ls=(0, (2, 2)), zorder=0.5)
            if axes is not self.rows[0]:
                axes.axvspan(*map(self.second, self.story.freeze_ns), color=FREEZE, alpha=0.45, lw=0, zorder=0)
                axes.axvspan(*map(self.second, self.story.kill_ns), color=FREEZE, alpha=0.45, lw=0, zorder=0)
            axes.set_xlim(0, self.t_s[-1])


def timeline(
    records: npt.NDArray[Any], made: losses.Releases, story: Story, summary: dict[str, Any], path: Path
) -> None:
    """Agent phases, hand-off time, release jitter, tracking: one row each, with the swaps and the freeze marked."""
    picture = _Timeline(records, story, summary)
    picture.phases()
    due_ns = records["release_ns"].astype(np.int64)
    picture.timing(picture.rows[1], due_ns, records["handoff_ns"], "handoff_us", "(b) Hand-off time", BLUE)
    picture.timing(picture.rows[2], made.due_ns, made.late_ns, "release_jitter_us", "(c) Release jitter", GREEN)
    picture.tracking()
    picture.marks()
    picture.figure.savefig(path, dpi=160)
    plt.close(picture.figure)


def draw(records: npt.NDArray[Any], story: Story, summary: dict[str, Any], out: Path) -> None:
    """timing.png and timeline.png."""
    made = losses.releases(records, round(1e9 / summary["rate_hz"]))
    with plt.rc_context(STYLE):
        distributions(records, made.late_ns, summary, out / "timing.png")
        timeline(records, made, story, summary, out / "timeline.png")
