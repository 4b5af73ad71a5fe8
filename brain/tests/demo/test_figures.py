# SPDX-License-Identifier: Apache-2.0
"""The figures are drawn, and the report is printed, whatever the recording holds."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import synthetic
from lithe.demo import evidence, figures, judge, report, verdict


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
    figures.draw(made, told, judge.summarise(made, told, synthetic.SIMS[:1], synthetic.robot_info(), 0), tmp_path)
    for name in ("timing.png", "timeline.png"):
        data = (tmp_path / name).read_bytes()
        assert data[:8] == b"\x89PNG\r\n\x1a\n" and len(data) > 10_000


def drawn(tmp_path: Path, joints: int) -> figures._Timeline:
    """The fourth row of the timeline, of a robot with so many joints under gravity."""
    made, told = synthetic.records(joints=3), synthetic.story(3)
    summary = synthetic.summary(joints=3)
    many = [summary["joints"][0] | {"name": f"joint{number}"} for number in range(joints)]
    picture = figures._Timeline(made, told, summary | {"joints": many})
    picture.tracking()
    picture.figure.savefig(tmp_path / "tracking.png")
    return picture


@pytest.mark.parametrize("joints", [2, 12, 32])
def test_many_joints_have_a_line_each_and_words_that_hide_none(tmp_path: Path, joints: int) -> None:
    axes = drawn(tmp_path, joints).rows[3]
    legend = axes.get_legend()
    assert [text.get_text() for text in legend.get_texts()] == [f"joint{number}" for number in range(joints)]
    lines = [line for line in axes.lines if line.get_label().startswith("joint")]
    assert len(lines) == joints and len({tuple(line.get_color()) for line in lines}) == joints
    box = legend.get_window_extent().transformed(axes.transData.inverted())
    assert box.y1 < min(float(line.get_ydata().min()) for line in lines)
    assert legend.get_window_extent().x1 <= axes.get_window_extent().x1


def test_one_joint_shows_its_angle(tmp_path: Path) -> None:
    axes = drawn(tmp_path, 1).rows[3]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["setpoint", "arm"]


def test_the_report_has_a_row_for_each_of_several_joints(capsys: pytest.CaptureFixture[str]) -> None:
    summary = synthetic.summary(joints=3) | verdict.Verdict().told()
    report.report(summary, Path("out"))
    said = capsys.readouterr().out
    rows = [line.split()[:7] for line in said.splitlines()]
    assert ["shoulder", "0.1600", "0.1552", "-", "0.1648", "0.1650", "3.0%"] in rows
    assert ["boom", "1.5100", "1.4647", "-", "1.5553", "1.5000", "0.7%"] in rows
    assert ["column", "none", "0.0000", "0.0%"] in [row[:4] for row in rows]


def test_the_report_names_every_phase_swap_and_shortcoming(capsys: pytest.CaptureFixture[str]) -> None:
    told = synthetic.story()
    told.swaps[0]["cached"] = True
    summary = judge.summarise(synthetic.records(), told, synthetic.SIMS[:1], synthetic.robot_info(), 0)
    summary |= verdict.Verdict(["the arm fell off"], ["a stall"]).told()
    report.report(summary, Path("out"))
    said = capsys.readouterr().out
    heads, *rows = [line.split() for line in said.splitlines() if "stages" in line or line.endswith("310.0")]
    assert heads == ["stages", "[ms]", "queued", "compiled", "tried", "in", "all"]
    assert rows == [[law, "0.5", "300.0", "9.5", "310.0"] for law in ("probe", "evolved")]
    for words in (*judge.PHASES, "probe        taken from the cache", "evolved      compiled in  300 ms",
                  "6 of 14006 releases in the run (0.04%); the machine's: 0, our own: 6", "INCONCLUSIVE: a stall",
                  "FALLS SHORT: the arm fell off", "the claim falls short"):  # fmt: skip
        assert words in said


def test_the_report_of_a_stop_says_whose_fault_it_was(capsys: pytest.CaptureFixture[str]) -> None:
    told = verdict.of_stop(synthetic.records(2_000), evidence.NONE, "sample_stale", "probing", 1_000_000)
    report.report_stop(told | {"machine": synthetic.summary()["machine"]}, Path("out"))
    said = capsys.readouterr().out
    assert "stopped itself in phase 'probing' (sample_stale)" in said and "the claim falls short" in said
