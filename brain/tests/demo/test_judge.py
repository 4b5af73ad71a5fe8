# SPDX-License-Identifier: Apache-2.0
"""The judge, on a recording whose answers are known."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import synthetic
from lithe.demo import judge
from lithe.demo import verdict as verdicts
from lithe.demo.evidence import Evidence
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
    chance = summary["timing"]["commits"]["chance"]
    assert chance == pytest.approx(2 * 2 / (2 + summary["no_swap_windows"]["windows"]), rel=0.01)


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


def test_the_interval_is_held_against_the_truth(summary: dict[str, Any]) -> None:
    (joint,) = summary["joints"]
    assert summary["mgl_interval_nm"] == joint["mgl_interval_nm"] == pytest.approx([0.97 * 0.16, 1.03 * 0.16])
    assert joint["mgl_half_width"] == pytest.approx(0.03)
    assert joint["mgl_off_intervals"] == pytest.approx(0.005 / (0.03 * 0.16)), "a little outside"


def experiment(summary: dict[str, Any]) -> list[str]:
    return verdicts.experiment(summary)


def made_good(summary: dict[str, Any]) -> dict[str, Any]:
    for joint in summary["joints"]:
        for name in joint["rmse_deg"]:
            joint["rmse_deg"][name] = 70.0 if name in ("baseline", "probing") else 1.0
    summary["swaps"] += [dict(swap) for swap in summary["swaps"]]  # the recording has two
    return summary


@pytest.fixture
def good(summary: dict[str, Any]) -> dict[str, Any]:
    """A run that holds."""
    return made_good(summary)


def test_the_claim_holds_only_when_every_part_of_it_does(good: dict[str, Any]) -> None:
    assert experiment(good) == [] and verdicts.verdict(good).word == "holds"


NAN = float("nan")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda s: s["joints"][0].update(mgl_error=0.06), "mgl is off by 6.0%"),
        (lambda s: s["joints"][0].update(mgl_error=NAN), "mgl is off by nan%"),
        (
            lambda s: s["joints"][0].update(mgl_off_intervals=3.1),
            "lies far outside the agent's interval 0.1552 to 0.1648",
        ),
        (lambda s: s["joints"][0].update(mgl_off_intervals=NAN), "lies far outside"),
        (lambda s: s["joints"][0].update(mgl_half_width=0.11), "interval is +-11.0% wide, more than 10%"),
        (lambda s: s["joints"][0].update(mgl_half_width=NAN), "interval is +-nan% wide"),
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
        (lambda s: s.update(swaps=[]), "0 laws were swapped in"),
        (lambda s: s["swaps"].pop(), "3 laws were swapped in, at least 4"),
        (
            lambda s: s["timing"]["commits"].update(chance=0.0009),
            "swaps lose ticks around a commit: 2 missed in 1 of 2",
        ),
        (lambda s: s["timing"]["commits"].update(chance=NAN), "swaps lose ticks around"),
        (lambda s: s["timing"]["swaps"].update(chance=NAN), "swaps lose ticks between"),
        (lambda s: s["timing"]["run"].update(share=0.0011), "in the run 6 of 14006 releases were missed"),
        (lambda s: s["timing"]["run"].update(share=NAN), "in the run 6"),
        (lambda s: s.update(records_lost=1), "1 telemetry records were overwritten"),
        (lambda s: s.update(records_lost=NAN), "telemetry records were overwritten"),
    ],
)
def test_each_way_to_fall_short_is_named(good: dict[str, Any], spoil: Any, words: str) -> None:
    spoil(good)
    told = verdicts.verdict(good)
    assert told.word == "falls_short" and any(words in sentence for sentence in told.falls_short), told


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
    assert made_good(summary) and experiment(summary) == []


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
    assert [words in sentence for sentence in experiment(summary)] == [True], experiment(summary)


def test_a_joint_that_gravity_pushes_away_bears_it_too() -> None:
    """A robot file that says mgl < 0 is not read as one without gravity."""
    sims = [SimJoint("shoulder", -0.165)]
    summary = judge.summarise(synthetic.records(), synthetic.story(), sims, synthetic.robot_info(), 0)
    (joint,) = summary["joints"]
    assert joint["bears_gravity"] and joint["mgl_error"] == pytest.approx((0.16 + 0.165) / 0.165)
    joint["mgl_error"], joint["mgl_off_intervals"] = mgl_error(0.0, sims[0]), 0.0
    made_good(summary)
    assert experiment(summary) == ["mgl is off by 100.0%, more than 5%"]


def test_a_joint_without_gravity_need_not_track() -> None:
    summary = made_good(synthetic.summary(joints=3))
    summary["joints"][2]["rmse_deg"]["evolved"] = 9.0
    assert experiment(summary) == []


def test_the_largest_step_is_that_which_takes_most_of_its_bound() -> None:
    made = synthetic.records(joints=3)
    made["command_torque_nm"][synthetic.SWAP_TICKS[0] :, 1] = 1.6  # of 1.5; 0.12 of 0.12; 0.12 of 2.0
    summary = judge.summarise(made, synthetic.story(3), synthetic.SIMS, synthetic.robot_info(3), 0)
    step = summary["swaps"][0]
    assert (step["output_step_joint"], step["output_step_nm"]) == (1, pytest.approx(1.6))
    assert step["output_step_bound_nm"] == pytest.approx(1.5)
    assert any("stepped the torque of joint 'boom' by 1.6000 N m" in sentence for sentence in experiment(summary))


COMMITS = range(2_000, 14_000, 2_000)


def run(
    lost_before: list[int], ended_late: Sequence[int] = (), took_ms: int = 0, took_ticks: Sequence[int] = ()
) -> dict[str, Any]:
    """Six swaps; a release is skipped before some ticks, others end late; the machine took so much near some ticks."""
    made, told = synthetic.records(), synthetic.story()
    skipped = np.isin(made["tick"], lost_before)
    made["missed_releases"] = np.cumsum(skipped)
    made["release_ns"] = 10**12 + (made["tick"].astype(np.int64) + np.cumsum(skipped)) * 1_000_000
    made["flags"] = np.where(skipped | np.isin(made["tick"], np.array(ended_late) + 1), 512, 0)  # said by the next tick
    first = told.swaps[0]
    told.swaps = [first | {"commit_tick": tick, "sent_ns": 10**12 + (tick - 300) * 1_000_000} for tick in COMMITS]
    at_ns = np.arange(10**12, 10**12 + 15 * 10**9, 50_000_000, dtype=np.int64)
    taken_ns = [10**12 + tick * 1_000_000 for tick in took_ticks]
    waited_ns = took_ms * 1_000_000 * np.searchsorted(np.array(sorted(taken_ns), np.int64), at_ns)
    evidence = Evidence(at_ns, waited_ns, 0 * at_ns)
    summary = judge.summarise(made, told, synthetic.SIMS[:1], synthetic.robot_info(), 0, evidence)
    return made_good(summary)


def test_a_run_that_misses_its_deadlines_never_holds() -> None:
    """As it was seen: 11 % of the deadlines missed, 110 ticks lost between request and commit."""
    told = verdicts.verdict(run([], ended_late=list(range(5, 14_000, 9))))
    assert told.word == "falls_short" and "11.1" in told.falls_short[0], told
    lost = [tick - 280 + i for tick in COMMITS for i in range(18)]
    told = verdicts.verdict(run(lost))
    assert told.word == "falls_short" and any("between request and commit" in each for each in told.falls_short), told


def test_swaps_that_lose_ticks_fall_short() -> None:
    """A Spine that is delayed on purpose at its commits, and nothing that the machine took explains it."""
    for lost in ([tick + 5 for tick in COMMITS], [2_005, 3_100, 6_005, 8_020, 11_000, 12_010]):
        told = verdicts.verdict(run(lost))
        assert told.word == "falls_short" and any("around a commit" in each for each in told.falls_short), told
    elsewhere = [tick + 1_000 for tick in COMMITS]
    told = verdicts.verdict(run([tick + 5 for tick in COMMITS], took_ms=30, took_ticks=elsewhere))
    assert told.word == "falls_short", "what the machine takes at other times is no excuse"


def test_a_noisy_machine_is_inconclusive_and_accuses_no_swap() -> None:
    for lost in (list(range(5, 14_000, 50)), [tick + 5 for tick in COMMITS], [tick - 150 for tick in COMMITS]):
        told = verdicts.verdict(run(lost, took_ms=1, took_ticks=lost))
        assert told.word in ("INCONCLUSIVE", "holds") and told.falls_short == [], told
    many = list(range(5, 14_000, 50))
    assert verdicts.verdict(run(many, took_ms=1, took_ticks=many)).word == "INCONCLUSIVE"
    assert verdicts.verdict(run(many)).word == "falls_short", "without evidence it is nobody else's fault"
    assert verdicts.verdict(run(many, took_ms=1, took_ticks=many[::3])).word == "falls_short", "a third of it explained"


def test_one_stall_in_a_swap_that_nothing_explains_is_inconclusive() -> None:
    """It may have been the machine's or the swap's: elsewhere as much is lost."""
    stall = [tick - 150 + i for tick in (2_000,) for i in range(8)]
    told = verdicts.verdict(run([*stall, 3_000, 3_500, 5_000]))
    assert told.word == "INCONCLUSIVE" and "elsewhere in the run as much" in told.inconclusive[0], told
    assert verdicts.verdict(run([2_005])).word == verdicts.verdict(run([])).word == "holds"


def test_a_law_that_tracks_badly_is_judged_only_where_the_machine_leaves_it_the_core() -> None:
    for share, word in ((100, "falls_short"), (50, "INCONCLUSIVE")):  # 1 % and 2 % of the releases
        lost = list(range(5, 14_000, share))[: 139 if share == 100 else None]
        summary = run(lost, took_ms=1, took_ticks=lost)
        summary["joints"][0]["rmse_deg"]["evolved"] = 9.0
        told = verdicts.verdict(summary)
        assert told.word == word and any("RMSE evolved" in each for each in told.falls_short + told.inconclusive), told


@pytest.mark.parametrize(("took_ms", "word"), [(0, "falls_short"), (4, "falls_short"), (40, "INCONCLUSIVE")])
def test_a_stop_is_the_machines_only_where_the_evidence_says_so(took_ms: int, word: str) -> None:
    made = synthetic.records(5_000)
    made["missed_releases"] = 40 * (made["tick"] >= 4_900)
    made["release_ns"] = 10**12 + (made["tick"].astype(np.int64) + made["missed_releases"]) * 1_000_000
    made["fault"][4_900:] = 8
    at_ns = np.arange(10**12, int(made["release_ns"][-1]), 50_000_000, dtype=np.int64)
    evidence = Evidence(at_ns, took_ms * 1_000_000 * (at_ns > at_ns[-3]), 0 * at_ns)
    told = verdicts.of_stop(made, evidence, "deadline_missed", "probing", 1_000_000)
    assert told["verdict"] == word and told["stopped"] == {"fault": "deadline_missed", "phase": "probing"}
    (sentence,) = told["falls_short"] + told["inconclusive"]
    assert "40 of 1000 releases were missed" in sentence and f"{min(took_ms, 40)} of these" in sentence


def test_a_recording_that_ends_before_the_freeze_proves_nothing() -> None:
    summary = judge.summarise(
        synthetic.records(7_000), synthetic.story(), synthetic.SIMS[:1], synthetic.robot_info(), 0
    )
    wrong = experiment(summary)
    assert any("gravity torque only" in sentence for sentence in wrong)
    assert any("RMSE resumed nan" in sentence for sentence in wrong)
