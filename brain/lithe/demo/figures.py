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

from .judge import Story

INK, BLUE, ORANGE, GREY, RED = "#222222", "#2b6cb0", "#dd8a1a", "#b8bec7", "#c0392b"
PHASE_COLOURS = {
    "baseline": "#e8c9c4", "probing": "#f1dfb5", "evolved": "#cfe3cf",
    "frozen": "#b9cfe8", "resumed": "#cfe3cf", "killed": "#b9cfe8", "reattached": "#cfe3cf",
}  # fmt: skip


def _bare(axes: Any) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)


def distributions(records: npt.NDArray[Any], summary: dict[str, Any], path: Path) -> None:
    """Histograms of hand-off time and release jitter, with the quantiles that matter marked."""
    figure, rows = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    for axes, key, field, title in (
        (rows[0], "handoff_us", "handoff_ns", "Hand-off: woken to command dispatched"),
        (rows[1], "release_jitter_us", "release_jitter_ns", "Release jitter: woken minus due"),
    ):
        values = np.maximum(records[field] / 1e3, 1e-3)
        edges = np.logspace(np.log10(values.min()), np.log10(max(values.max(), 2 * values.min())), 80)
        axes.hist(values, edges, color=BLUE, alpha=0.85)
        axes.set_xscale("log")
        axes.set_yscale("log")
        top = axes.get_ylim()[1]
        for label, colour in (("p50", INK), ("p99", ORANGE), ("p999", ORANGE), ("max", RED)):
            value = max(summary[key][label], 1e-3)
            name = "p99.9" if label == "p999" else label
            axes.axvline(value, color=colour, linewidth=1, linestyle="--")
            axes.text(value, top, f" {name} {value:.2f}", rotation=90, va="top", ha="right", fontsize=7, color=colour)
        axes.set_title(title, fontsize=9)
        axes.set_xlabel("us", fontsize=8)
        axes.set_ylabel("ticks", fontsize=8)
        _bare(axes)
    machine = summary["machine"]
    figure.suptitle(
        f"{summary['ticks']} ticks on {machine['cpu']}, Linux {machine['kernel']}", fontsize=8, color="#666666"
    )
    figure.savefig(path, dpi=160)
    plt.close(figure)


def _phases(axes: Any, story: Story, zero_ns: int) -> None:
    for phase in story.phases:
        left, right = (phase["from_ns"] - zero_ns) * 1e-9, (phase["to_ns"] - zero_ns) * 1e-9
        axes.axvspan(left, right, color=PHASE_COLOURS.get(phase["name"], GREY), lw=0)
        if right - left > 1.2:
            axes.text((left + right) / 2, 0.72, phase["name"], ha="center", va="center", fontsize=8, color=INK)
    for sent_ns, swap in zip(story.sent_ns, story.swaps, strict=False):
        t = (sent_ns - zero_ns) * 1e-9
        axes.annotate(
            swap["law"], xy=(t, 0.45), xytext=(t, 0.18), ha="center", fontsize=7, color=BLUE,
            arrowprops={"arrowstyle": "-|>", "color": BLUE, "lw": 1},
        )  # fmt: skip
    axes.set_ylim(0, 1)
    axes.set_yticks([])
    axes.set_ylabel("agent", fontsize=8)


def timeline(records: npt.NDArray[Any], story: Story, summary: dict[str, Any], path: Path) -> None:
    """Agent phases, hand-off time, release jitter, tracking: one row each, with the swaps and the freeze marked."""
    zero_ns = int(records["release_ns"][0])
    t = (records["release_ns"] - zero_ns) * 1e-9
    figure, rows = plt.subplots(
        4, 1, figsize=(10, 7), sharex=True, layout="constrained", gridspec_kw={"height_ratios": [0.8, 1, 1, 2.2]}
    )
    _phases(rows[0], story, zero_ns)
    for axes, field, label in (
        (rows[1], "handoff_ns", "hand-off\n[us]"),
        (rows[2], "release_jitter_ns", "jitter\n[us]"),
    ):
        axes.plot(t, np.maximum(records[field] / 1e3, 1e-3), ".", markersize=1.2, color=BLUE, rasterized=True)
        axes.set_yscale("log")
        axes.set_ylabel(label, fontsize=8)
    tracking = rows[3]
    tracking.plot(t, np.degrees(records["setpoint_position_rad"][:, 0]), color=GREY, linewidth=2.2, label="setpoint")
    tracking.plot(t, np.degrees(records["position_rad"][:, 0]), color=ORANGE, linewidth=1.1, label="arm")
    for phase in summary["phases"]:
        if phase["name"] in ("baseline", "evolved", "resumed", "reattached"):
            place = next(p for p in story.phases if p["name"] == phase["name"])
            middle = ((place["from_ns"] + place["to_ns"]) / 2 - zero_ns) * 1e-9
            tracking.text(middle, 1.01, f"RMSE {phase['rmse_deg']:.2f} deg", transform=tracking.get_xaxis_transform(),
                          ha="center", va="bottom", fontsize=8)  # fmt: skip
    tracking.set_ylabel("angle [deg]", fontsize=8)
    tracking.set_xlabel("time [s]", fontsize=8)
    tracking.legend(loc="lower right", fontsize=8, frameon=False, ncols=2)
    ticks = {int(tick): when for tick, when in zip(records["tick"], t, strict=True)}
    for axes in rows:
        for swap in summary["swaps"]:
            if swap["commit_tick"] in ticks:
                axes.axvline(ticks[swap["commit_tick"]], color=BLUE, linewidth=0.9, linestyle=":")
        axes.axvspan(*((when - zero_ns) * 1e-9 for when in story.freeze_ns), color="#b9cfe8", alpha=0.6, lw=0)
        _bare(axes)
    tracking.text(
        (story.freeze_ns[0] - zero_ns) * 1e-9,
        0.02,
        " Brain frozen",
        transform=tracking.get_xaxis_transform(),
        fontsize=8,
    )
    figure.savefig(path, dpi=160)
    plt.close(figure)


def draw(records: npt.NDArray[Any], story: Story, summary: dict[str, Any], out: Path) -> None:
    distributions(records, summary, out / "timing.png")
    timeline(records, story, summary, out / "timeline.png")
