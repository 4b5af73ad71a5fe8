# SPDX-License-Identifier: Apache-2.0
"""The report of a run: report.md, and rmse.png where matplotlib is installed."""

from __future__ import annotations

import html
import re
from pathlib import Path

from .rounds import Result
from .score import SCORES, score


def _cell(text: str, most: int = 160) -> str:
    """Foreign text in a table: one line, nothing that Markdown or HTML would take for its own."""
    shown = "".join(char if char.isprintable() else " " for char in text[:most])
    return re.sub(r"([|`\[\]\\!*_])", r"\\\1", html.escape(shown))


def markdown(result: Result, goal: str, model: str, names: list[str], figure: bool) -> str:
    lines = [
        "# What the agent did",
        "",
        f"Goal: {_cell(goal)}. Model: {_cell(model)}. {len(result.tries) - 1} generations, {result.swaps} swaps, "
        f"{result.stops} stops.",
        f"It ended because: {_cell(result.why, 400)}.",
        "",
    ]
    if result.tries:
        best = result.tries[result.best]
        now, start = (score(one.measured, result.kind) for one in (best, result.tries[0]))
        lines += [
            f"The best law is generation {best.number} ({_cell(best.name)}): {SCORES[result.kind]} {now:.4f}, "
            f"at the start {start:.4f}: {result.ratio:.1f} times less.",
            "",
        ]
    lines += ["![RMSE of each generation](rmse.png)", ""] if figure else []
    shown = dict.fromkeys((result.kind, "rms"))
    heads = ("generation", "verdict", "amplitude", *(SCORES[one] for one in shown), "kept", "what was said")
    lines += [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for one in result.tries:
        values = [", ".join(f"{each:.4f}" for each in one.measured.joints(kind)) if one.measured else "not measured"
                  for kind in shown]  # fmt: skip
        kept = "yes" if one.kept else ""
        cells = (str(one.number), _cell(one.verdict), f"{one.share:.0%}", *values, kept, _cell(one.said))
        lines.append(f"| {' | '.join(cells)} |")
    lines += ["", f"Joints, in this order: {', '.join(_cell(name, 40) for name in names)}.", ""]
    lines += [f"- {_cell(str(each), 300)}" for each in result.plant]
    lines += [
        "",
        "All that was said and received: transcript.jsonl, each line with the SHA-256 of the line before.",
        "",
    ]
    return "\n".join(lines)


def draw(result: Result, path: Path) -> bool:
    """RMSE of each generation that was measured, on a logarithmic axis. False: matplotlib is not installed."""
    measured = [one for one in result.tries if one.measured]
    try:
        from matplotlib import pyplot as plt

        from ..demo import figures
    except ImportError:
        return False
    if not measured:
        return False
    with plt.rc_context(figures.STYLE):
        picture, axes = plt.subplots(figsize=(7.2, 3.4), layout="constrained")
        for kept, colour, word in ((True, figures.GREEN, "kept"), (False, figures.RED, "taken back")):
            those = [one for one in measured if one.kept is kept]
            scores = [max(score(one.measured, "rms"), figures.LEAST_DEG) for one in those]
            axes.semilogy([one.number for one in those], scores, "o", color=colour, label=word)
        axes.minorticks_off()
        figures.plain_numbers(axes.yaxis)
        axes.set_xlabel("generation")
        axes.set_ylabel("RMSE [deg]")
        axes.set_title("RMSE of each generation that was measured")
        axes.legend(frameon=False)
        picture.savefig(path, dpi=150)
        plt.close(picture)
    return True


def write(result: Result, folder: Path, goal: str, model: str, names: list[str]) -> Path:
    """report.md in `folder`, with best.cpp when the best law's source is known."""
    figure = draw(result, folder / "rmse.png")
    path = folder / "report.md"
    path.write_text(markdown(result, goal, model, names, figure), encoding="utf-8")
    if result.source:
        (folder / "best.cpp").write_text(result.source, encoding="utf-8")
    return path
