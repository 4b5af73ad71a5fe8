# SPDX-License-Identifier: Apache-2.0
"""The figure in the paper's layout, and one self-contained page."""

from __future__ import annotations

import base64
import html
import json
from pathlib import Path

import numpy as np

from bench.isolation.figures import LEAST_US, Rounds, calm
from bench.tables import Figures

PAPER_HANDOFF_US = 98.299  # the worst of the paper, under stress-ng, on its Raspberry Pi
PAPER_JITTER_US = 3.110
WORDS = {
    "floor": "bare spin (floor)", "writing": "spin that writes as a tick does", "lithe": "LITHE",
    "cyclictest": "cyclictest", "plain_loop": "clock_nanosleep loop", "moteus_loop": "moteus, asyncio",
}  # fmt: skip


def draw(seen: dict[str, dict[str, Rounds]], told: Figures, path: Path) -> None:
    """(a) hand-off time and (b) release jitter with the paper's ranges and bins; (c) how late every program was."""
    from lithe.demo.figures import BLUE, GREEN, GREY, INK, ORANGE, RED, STYLE  # chooses a backend without a display
    from matplotlib import pyplot as plt

    colours = dict(zip(("stress", "numpy", "compile", "swap", "idle"), (RED, BLUE, ORANGE, GREEN, GREY), strict=True))
    programs = dict(zip(WORDS, (GREY, INK, BLUE, RED, ORANGE, GREEN), strict=True))
    with plt.rc_context(STYLE):
        figure = plt.figure(figsize=(11, 6.6), layout="constrained")
        above, below = figure.subfigures(2, 1)
        panels = above.subplots(1, 2)
        handoff_bins, jitter_bins = np.arange(0, 102, 2.0), np.arange(0, 4.08, 0.08)
        for name, programs_seen in seen.items():
            records = np.concatenate(programs_seen["lithe"])
            handoff_us = records["handoff_ns"][records["handoff_ns"] >= 0] / 1e3
            late_us = np.concatenate(calm(programs_seen["lithe"])) / 1e3
            for axes, values, bins in ((panels[0], handoff_us, handoff_bins), (panels[1], late_us, jitter_bins)):
                outside = np.count_nonzero(values > bins[-1]) / max(len(values), 1)
                label = f"{name}, max {values.max():,.3f} µs" if len(values) else f"{name}, all stolen"
                label += f", {outside:.2%} beyond" if outside else ""
                axes.stairs(np.histogram(values, bins)[0], bins, color=colours[name], label=label)
        for axes, paper_us, title in (
            (panels[0], PAPER_HANDOFF_US, "(a) Hand-off time of LITHE"),
            (panels[1], PAPER_JITTER_US, "(b) Release jitter of LITHE, steal-aware"),
        ):
            axes.axvline(paper_us, color=INK, lw=0.9, ls=":", label=f"the paper's worst, {paper_us:.4g} µs")
            axes.set_yscale("log")
            axes.set_title(title)
            axes.set_xlabel("µs")
            axes.legend(fontsize=7, frameon=False)
        panels[0].set_ylabel("ticks")
        rows = np.atleast_1d(below.subplots(1, len(seen), sharey=True))
        for axes, (name, programs_seen) in zip(rows, seen.items(), strict=True):
            for program, rounds in programs_seen.items():
                late_us = np.sort(np.maximum(np.concatenate(calm(rounds)) / 1e3, 0.01))
                later = 1 - np.arange(len(late_us)) / len(late_us)
                if len(late_us):
                    axes.plot(late_us, later, color=programs[program], lw=1.1, label=WORDS[program])
            axes.set(xscale="log", yscale="log", xlabel="µs")
            axes.axvline(LEAST_US, color=GREY, lw=0.5)
            axes.set_title(name)
        rows[0].set_ylabel("(c) share of cycles later than x")
        rows[0].legend(*rows[0].get_legend_handles_labels(), fontsize=7, frameon=False)
        figure.suptitle(
            f"{told['machine_cpu']} · Linux {told['machine_kernel']} · {told['verdict']}", fontsize=8, color=GREY
        )
        figure.savefig(path, dpi=130)
        plt.close(figure)


def page(told: Figures, text: str, doctor: str, figure: Path, path: Path) -> None:
    """One HTML file with everything in it: verdict, figure, tables, the doctor's JSON, all figures."""
    image = base64.b64encode(figure.read_bytes()).decode()
    parts = [
        "<!doctype html><meta charset=utf-8><title>LITHE: isolation</title>",
        "<style>body{font:15px sans-serif;max-width:1150px;margin:2em auto;padding:0 1em}pre{overflow:auto}"
        "img{max-width:100%}</style>",
        f"<h1>Isolation: {html.escape(str(told['verdict']))}</h1><p>{html.escape(str(told['reason']))}</p>",
        f'<img alt="hand-off time and release jitter" src="data:image/png;base64,{image}">',
        f"<pre>{html.escape(text)}</pre>",
        f"<details><summary>lithe doctor</summary><pre>{html.escape(doctor)}</pre></details>",
        f"<details><summary>all figures</summary><pre>{html.escape(json.dumps(told, indent=1))}</pre></details>",
    ]
    path.write_text("\n".join(parts) + "\n", encoding="utf-8")
