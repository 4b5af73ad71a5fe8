# SPDX-License-Identifier: Apache-2.0
"""The figures are drawn, and the report is printed, whatever the recording holds."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import synthetic
from lithe.demo import figures, judge, report


def still(records: npt.NDArray[np.void]) -> None:
    records["release_jitter_ns"] = 0
    records["handoff_ns"] = 0


def terrible(records: npt.NDArray[np.void]) -> None:
    records["release_jitter_ns"][::100] = 4_000_000_000


@pytest.mark.parametrize("change", [lambda _: None, still, terrible], ids=["plain", "no spread", "seconds late"])
def test_both_figures_are_drawn(tmp_path: Path, change: object) -> None:
    made, told = synthetic.records(), synthetic.story()
    assert callable(change)
    change(made)
    figures.draw(made, told, judge.summarise(made, told, 0.165, synthetic.robot_info(), 0), tmp_path)
    for name in ("timing.png", "timeline.png"):
        data = (tmp_path / name).read_bytes()
        assert data[:8] == b"\x89PNG\r\n\x1a\n" and len(data) > 10_000


def test_the_report_names_every_phase_swap_and_shortcoming(capsys: pytest.CaptureFixture[str]) -> None:
    told = synthetic.story()
    told.swaps[0]["cached"] = True
    summary = judge.summarise(synthetic.records(), told, 0.165, synthetic.robot_info(), 0)
    summary["attempts"] = [
        {"reason": "sample_stale", "phase": "probing", "seconds": 12.0},
        {"reason": "completed", "phase": "reattached", "seconds": 42.0},
    ]
    summary |= {"verdict": "falls short", "falls_short": ["the arm fell off"]}
    report.report(summary, Path("out"))
    said = capsys.readouterr().out
    heads, *rows = [line.split() for line in said.splitlines() if "stages" in line or line.endswith("310.0")]
    assert heads == ["stages", "[ms]", "queued", "compiled", "tried", "in", "all"]
    assert rows == [[law, "0.5", "300.0", "9.5", "310.0"] for law in ("probe", "evolved")]
    for words in (*judge.PHASES, "probe        taken from the cache", "evolved      compiled in  300 ms",
                  "after 12 s, safe stop (sample_stale) in 'probing'", "FALLS SHORT: the arm fell off"):  # fmt: skip
        assert words in said
