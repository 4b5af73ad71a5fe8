# SPDX-License-Identifier: Apache-2.0
"""The judge, on a recording whose answers are known."""

from typing import Any

import numpy as np
import pytest
import synthetic
from lithe.demo import judge
from lithe.demo.joints import SimJoint, mgl_error


@pytest.fixture
def summary() -> dict[str, Any]:
    return synthetic.summary()


def rmse(summary: dict[str, Any], name: str) -> float:
    return float(next(phase["rmse_deg"] for phase in summary["phases"] if phase["name"] == name))


def test_each_phase_has_its_own_error(summary: dict[str, Any]) -> None:
    assert rmse(summary, "baseline") == pytest.approx(10.0)
    assert rmse(summary, "resumed") == pytest.approx(1.0)


def test_lost_ticks_are_counted_at_each_swap_and_elsewhere(summary: dict[str, Any]) -> None:
    told = [(swap["lost_ticks"], swap["lost_ticks_prepare"], swap["lost_ticks_commit"]) for swap in summary["swaps"]]
    assert told == [(3, 1, 2), (0, 0, 0)]
    assert summary["swaps"][1]["window_ms"] == pytest.approx(363.0), (
        "310 ms to the commit, 3 ms lost by then, 50 ms more"
    )
    assert (summary["swap_windows"]["lost_ticks"], summary["swap_windows"]["windows"]) == (3, 2)
    assert (summary["commit_windows"]["lost_ticks"], summary["commit_windows"]["windows_with_loss"]) == (2, 1)
    assert (summary["no_swap_windows"]["lost_ticks"], summary["no_swap_windows"]["windows_with_loss"]) == (3, 1)
    assert summary["lost_ticks"] == 6
    assert 170 < summary["no_swap_windows"]["windows"] < 195
    assert summary["swap_loss_chance"] == pytest.approx(2 * 2 / (2 + summary["no_swap_windows"]["windows"]), rel=0.01)


def test_a_skipped_release_counts_as_late(summary: dict[str, Any]) -> None:
    assert summary["release_jitter_us"]["max"] > 3_000


def test_the_torque_step_at_a_swap_stands_beside_the_guards_bound(summary: dict[str, Any]) -> None:
    assert summary["swaps"][0]["output_step_nm"] == pytest.approx(0.12)
    assert summary["output_step_bound_nm"] == pytest.approx(0.12)


def test_the_freeze_tells_how_long_how_far_and_under_what_load(summary: dict[str, Any]) -> None:
    freeze = summary["freeze"]
    assert freeze["duration_s"] == pytest.approx(1.5)
    assert freeze["brain_silent_s"] == pytest.approx(1.5, abs=0.02)
    assert freeze["max_excursion_deg"] == pytest.approx(1.0)
    assert freeze["rest_angle_deg"] == pytest.approx(89.0)
    assert freeze["gravity_share"] > 0.99


def test_the_names_that_scripts_read_are_there(summary: dict[str, Any]) -> None:
    assert {"phases", "mgl_true_nm", "mgl_hat_nm", "mgl_error", "estimate", "swaps", "ticks"} <= set(summary)
    assert {"missed_deadlines", "output_step_bound_nm", "joints"} <= set(summary)
    assert {"max_excursion_deg", "rest_angle_deg", "rest_sag_deg", "gravity_share"} <= set(summary["freeze"])
    for key in ("handoff_us", "release_jitter_us"):
        assert set(summary[key]) == {"p50", "p99", "p999", "max"}
    for swap in summary["swaps"]:
        assert {"law", "compile_ms", "commit_tick", "lost_ticks"} <= set(swap)
        assert sum(swap["split_ms"].values()) == pytest.approx(swap["requested_to_committed_ms"])
    assert {"cpu", "kernel", "cores", "privileges", "lost"} <= set(summary["machine"])


def made_good(summary: dict[str, Any]) -> dict[str, Any]:
    for joint in summary["joints"]:
        for name in joint["rmse_deg"]:
            joint["rmse_deg"][name] = 70.0 if name in ("baseline", "probing") else 1.0
    return summary


@pytest.fixture
def good(summary: dict[str, Any]) -> dict[str, Any]:
    """A run that holds."""
    return made_good(summary)


def test_the_claim_holds_only_when_every_part_of_it_does(good: dict[str, Any]) -> None:
    assert judge.verdict(good) == []


NAN = float("nan")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda s: s["joints"][0].update(mgl_error=0.06), "mgl is off by 6.0%"),
        (lambda s: s["joints"][0].update(mgl_error=NAN), "mgl is off by nan%"),
        (lambda s: s["phases"].pop(3), "phase 'evolved' is missing"),
        (lambda s: s["phases"].pop(2), "phase 'gravity_only' is missing"),
        (lambda s: s["joints"][0]["rmse_deg"].update(gravity_only=NAN), "RMSE gravity_only"),
        (lambda s: s["joints"][0]["rmse_deg"].update(evolved=3.5), "RMSE evolved"),
        (lambda s: s["joints"][0]["rmse_deg"].update(baseline=7.0), "RMSE evolved"),
        (lambda s: s["joints"][0]["rmse_deg"].update(baseline=NAN), "RMSE evolved"),
        (lambda s: s["joints"][0]["rmse_deg"].update(reattached=NAN), "RMSE reattached"),
        (lambda s: s["joints"][0]["freeze"].update(max_excursion_deg=8.0), "frozen arm moved"),
        (lambda s: s["joints"][0]["freeze"].update(max_excursion_deg=NAN), "frozen arm moved"),
        (lambda s: s["joints"][0]["freeze"].update(gravity_share=0.7), "bore 70% of the largest gravity torque only"),
        (lambda s: s["joints"][0]["freeze"].update(gravity_share=NAN), "bore nan%"),
        (lambda s: s["freeze"].update(duration_s=1.0), "frozen for 1.00 s"),
        (lambda s: s["freeze"].update(duration_s=NAN), "frozen for nan s"),
        (lambda s: s["freeze"].update(brain_silent_s=0.1), "silent for 0.10 s only"),
        (lambda s: s["freeze"].update(brain_silent_s=NAN), "silent for nan s"),
        (lambda s: s["swaps"][1].update(output_step_nm=0.121), "'evolved' stepped the torque by 0.1210 N m"),
        (lambda s: s["swaps"][0].update(output_step_nm=NAN), "'probe' stepped the torque by nan"),
        (lambda s: s.update(swaps=[]), "no law was swapped"),
        (lambda s: s.update(swap_loss_chance=0.0009), "swaps lose ticks: 1 of 2 windows"),
        (lambda s: s.update(swap_loss_chance=NAN), "swaps lose ticks"),
        (lambda s: s.update(records_lost=1), "1 telemetry records were overwritten"),
        (lambda s: s.update(records_lost=NAN), "telemetry records were overwritten"),
    ],
)
def test_each_way_to_fall_short_is_named(good: dict[str, Any], spoil: Any, words: str) -> None:
    spoil(good)
    assert any(words in sentence for sentence in judge.verdict(good)), judge.verdict(good)


def test_of_several_joints_each_is_judged_that_bears_gravity() -> None:
    summary = synthetic.summary(joints=3)
    shoulder, boom, column = summary["joints"]
    assert [joint["name"] for joint in summary["joints"]] == ["shoulder", "boom", "column"]
    assert (shoulder["rmse_deg"]["resumed"], boom["rmse_deg"]["resumed"]) == (pytest.approx(1.0), pytest.approx(2.0))
    assert boom["freeze"]["rest_angle_deg"] == pytest.approx(88.0)
    assert boom["freeze"]["gravity_share"] == pytest.approx(np.sin(np.radians(88.0)) / 0.99), "of what it can bear"
    assert (column["bears_gravity"], column["mgl_error"]) == (False, 0.0)
    together = np.sqrt((1.0**2 + 2.0**2) / 2)
    assert rmse(summary, "resumed") == pytest.approx(together), "of those under gravity"
    assert (summary["mgl_true_nm"], summary["mgl_hat_nm"]) == (0.165, 0.16), "the one that is off most"
    assert summary["freeze"]["max_excursion_deg"] == pytest.approx(2.0)
    assert made_good(summary) and judge.verdict(summary) == []


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda s: s["joints"][1].update(mgl_error=0.06), "mgl is off by 6.0%, more than 5% (joint 'boom')"),
        (lambda s: s["joints"][1]["rmse_deg"].update(evolved=3.5), "RMSE evolved 3.50 deg, baseline 70.0 deg (joint"),
        (lambda s: s["joints"][1]["freeze"].update(gravity_share=0.5), "largest gravity torque only (joint 'boom')"),
        (lambda s: s["joints"][2].update(mgl_error=1.0), "believes that joint 'column' bears gravity"),
        (lambda s: s["joints"][2].update(mgl_error=NAN), "believes that joint 'column' bears gravity"),
        (lambda s: s["swaps"][0].update(output_step_nm=9.0, output_step_joint=1), "stepped the torque of joint 'boom'"),
    ],
)
def test_any_joint_can_fall_short_and_is_named(spoil: Any, words: str) -> None:
    summary = made_good(synthetic.summary(joints=3))
    spoil(summary)
    assert [words in sentence for sentence in judge.verdict(summary)] == [True], judge.verdict(summary)


def test_a_joint_that_gravity_pushes_away_bears_it_too() -> None:
    """A robot file that says mgl < 0 is not read as one without gravity."""
    sims = [SimJoint("shoulder", -0.165)]
    summary = judge.summarise(synthetic.records(), synthetic.story(), sims, synthetic.robot_info(), 0)
    (joint,) = summary["joints"]
    assert joint["bears_gravity"] and joint["mgl_error"] == pytest.approx((0.16 + 0.165) / 0.165)
    joint["mgl_error"] = mgl_error(0.0, sims[0])
    made_good(summary)
    assert judge.verdict(summary) == ["mgl is off by 100.0%, more than 5%"]


def test_a_joint_without_gravity_need_not_track() -> None:
    summary = made_good(synthetic.summary(joints=3))
    summary["joints"][2]["rmse_deg"]["evolved"] = 9.0
    assert judge.verdict(summary) == []


def test_the_largest_step_is_that_which_takes_most_of_its_bound() -> None:
    made = synthetic.records(joints=3)
    made["command_torque_nm"][synthetic.SWAP_TICKS[0] :, 1] = 1.6  # of 1.5; 0.12 of 0.12; 0.12 of 2.0
    summary = judge.summarise(made, synthetic.story(3), synthetic.SIMS, synthetic.robot_info(3), 0)
    step = summary["swaps"][0]
    assert (step["output_step_joint"], step["output_step_nm"]) == (1, pytest.approx(1.6))
    assert step["output_step_bound_nm"] == pytest.approx(1.5)
    assert any("stepped the torque of joint 'boom' by 1.6000 N m" in sentence for sentence in judge.verdict(summary))


def judged(lost_before: list[int]) -> list[str]:
    """What is said of six swaps when one release is skipped before each of these ticks."""
    made, told = synthetic.records(), synthetic.story()
    skipped = np.isin(made["tick"], lost_before)
    made["missed_releases"] = np.cumsum(skipped)
    made["release_ns"] = 10**12 + (made["tick"].astype(np.int64) + np.cumsum(skipped)) * 1_000_000
    first = told.swaps[0]
    commits = range(2_000, 14_000, 2_000)
    told.swaps = [first | {"commit_tick": tick, "sent_ns": 10**12 + (tick - 300) * 1_000_000} for tick in commits]
    sentences = judge.verdict(judge.summarise(made, told, synthetic.SIMS[:1], synthetic.robot_info(), 0))
    return [sentence for sentence in sentences if "swaps lose ticks" in sentence]


def test_swaps_that_lose_ticks_fall_short() -> None:
    assert judged([tick + 5 for tick in range(2_000, 14_000, 2_000)])
    assert judged([2_005, 3_100, 6_005, 8_020, 11_000, 12_010])


def test_a_noisy_machine_accuses_no_swap() -> None:
    assert judged([]) == []
    assert judged([2_005]) == judged([2_005, 2_006, 2_007, 2_008]) == [], "one stall of the machine"
    assert judged(list(range(5, 14_000, 50))) == [], "it stalls all the time"
    assert judged([tick - 150 for tick in range(2_000, 14_000, 2_000)]) == [], "it stalls when a compiler runs"


def test_a_recording_that_ends_before_the_freeze_proves_nothing() -> None:
    summary = judge.summarise(
        synthetic.records(7_000), synthetic.story(), synthetic.SIMS[:1], synthetic.robot_info(), 0
    )
    wrong = judge.verdict(summary)
    assert any("gravity torque only" in sentence for sentence in wrong)
    assert any("RMSE resumed nan" in sentence for sentence in wrong)
