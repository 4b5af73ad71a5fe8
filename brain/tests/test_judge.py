# SPDX-License-Identifier: Apache-2.0
"""The judge, on a recording whose answers are known."""

from typing import Any

import pytest
import synthetic
from lithe.demo import judge


@pytest.fixture
def summary() -> dict[str, Any]:
    return judge.summarise(synthetic.records(), synthetic.story(), 0.165, synthetic.robot_info(), 0)


def rmse(summary: dict[str, Any], name: str) -> float:
    return float(next(phase["rmse_deg"] for phase in summary["phases"] if phase["name"] == name))


def test_each_phase_has_its_own_error(summary: dict[str, Any]) -> None:
    assert rmse(summary, "baseline") == pytest.approx(10.0)
    assert rmse(summary, "resumed") == pytest.approx(1.0)


def test_lost_ticks_are_counted_near_each_swap_and_elsewhere(summary: dict[str, Any]) -> None:
    assert [swap["lost_ticks"] for swap in summary["swaps"]] == [2, 0]
    assert summary["no_swap_windows"]["lost_ticks"] == 3
    assert summary["lost_ticks"] == 5
    assert summary["no_swap_windows"]["windows"] > 100


def test_the_torque_step_at_a_swap_stands_beside_the_guards_bound(summary: dict[str, Any]) -> None:
    assert summary["swaps"][0]["output_step_nm"] == pytest.approx(0.12)
    assert summary["output_step_bound_nm"] == pytest.approx(0.12)


def test_the_freeze_tells_how_long_how_far_and_under_what_load(summary: dict[str, Any]) -> None:
    freeze = summary["freeze"]
    assert freeze["duration_s"] == pytest.approx(1.5)
    assert freeze["max_excursion_deg"] == pytest.approx(1.0)
    assert freeze["rest_angle_deg"] == pytest.approx(89.0)
    assert freeze["gravity_share"] > 0.99


def test_the_names_that_scripts_read_are_there(summary: dict[str, Any]) -> None:
    assert {"phases", "mgl_true_nm", "mgl_hat_nm", "swaps", "ticks", "missed_deadlines"} <= set(summary)
    for key in ("handoff_us", "release_jitter_us"):
        assert set(summary[key]) == {"p50", "p99", "p999", "max"}
    for swap in summary["swaps"]:
        assert {"law", "compile_ms", "commit_tick", "lost_ticks"} <= set(swap)
    assert {"cpu", "kernel", "cores", "privileges", "lost"} <= set(summary["machine"])


def test_the_claim_holds_only_when_every_part_of_it_does(summary: dict[str, Any]) -> None:
    for phase in summary["phases"]:
        phase["rmse_deg"] = 70.0 if phase["name"] in ("baseline", "probing") else 1.0
    assert judge.verdict(summary) == []


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda s: s.update(mgl_error=0.06), "mgl is off by 6.0%"),
        (lambda s: s["freeze"].update(max_excursion_deg=8.0), "frozen arm moved"),
        (lambda s: s["phases"].pop(2), "phase 'evolved' is missing"),
        (lambda s: s["phases"][2].update(rmse_deg=3.5), "RMSE evolved"),
        (lambda s: s["phases"][0].update(rmse_deg=7.0), "RMSE evolved"),
        (lambda s: s["phases"][5].update(rmse_deg=float("nan")), "RMSE reattached"),
    ],
)
def test_each_way_to_fall_short_is_named(summary: dict[str, Any], spoil: Any, words: str) -> None:
    for phase in summary["phases"]:
        phase["rmse_deg"] = 70.0 if phase["name"] in ("baseline", "probing") else 1.0
    spoil(summary)
    assert any(words in sentence for sentence in judge.verdict(summary))
