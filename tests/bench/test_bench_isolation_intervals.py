# SPDX-License-Identifier: Apache-2.0
"""The intervals of `make bench-isolation` hold the truth, on rounds whose truth is known."""

import math
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from isolation_records import module, records


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The bench's own module."""
    return module("figures", monkeypatch)


def test_ratios_and_shares_find_what_was_made(figures: ModuleType) -> None:
    rng = np.random.default_rng(1)
    rounds = [records(figures, np.where(rng.random(2500) < 0.01, 50.0, 0.1)) for _ in range(20)]
    quiet = [records(figures, np.full(2500, 0.2)) for _ in range(20)]
    told = figures.ratio_figures("r", figures.calm(rounds), figures.calm(quiet))
    assert told == {"r": 50.0, "r_low": 50.0, "r_high": 50.0}, "less than 1 us counts as 1 us"
    shares = figures.share_figures("s", figures.calm(rounds))
    assert shares["s_over_20us_low"] <= 0.01 <= shares["s_over_20us_high"] < 0.013
    assert shares["s_over_20us_low"] > 0.007 and shares["s_over_100us"] == 0
    gap = figures.difference_figures("d", figures.calm(rounds), figures.calm(quiet))
    assert gap["d_over_5us_difference_low"] > 0 and gap["d_over_100us_difference"] == 0


def test_an_interval_of_shares_holds_the_truth(figures: ModuleType) -> None:
    rng, missed, missed_by_half = np.random.default_rng(2), 0, 0
    for _ in range(60):
        rounds = [np.where(rng.random(500) < 0.02, 30_000, 100) for _ in range(24)]
        told = figures.share_figures("s", rounds)
        low, high, value = (told[f"s_over_20us{end}"] for end in ("_low", "_high", ""))
        missed += not low <= 0.02 <= high
        missed_by_half += not (low + value) / 2 <= 0.02 <= (high + value) / 2
    assert missed <= 9, "of 60; 3 are expected"
    assert missed_by_half > 9, "an interval half as wide is found out"


def test_an_interval_of_the_ratio_holds_the_truth_where_late_cycles_come_in_some_rounds(figures: ModuleType) -> None:
    rng, missed, missed_by_half, missed_by_cycles = np.random.default_rng(4), 0, 0, 0

    def rounds() -> list[Any]:
        """24 of 500 cycles; in a quarter of them 2 % of the cycles are late."""
        late = (rng.random((24, 500)) < 0.02) & (rng.random((24, 1)) < 0.25)
        return list((rng.exponential(300, late.shape) + late * rng.lognormal(10, 1, late.shape)).astype(np.int64))

    for _ in range(60):
        pair = rounds(), rounds()
        value, low, high = figures.ratio_figures("r", *pair).values()
        missed += not low <= 1 <= high
        missed_by_half += not (low + value) / 2 <= 1 <= (high + value) / 2
        mixed = [list(rng.permutation(np.concatenate(each)).reshape(24, 500)) for each in pair]
        _, low, high = figures.ratio_figures("r", *mixed).values()
        missed_by_cycles += not low <= 1 <= high
    assert missed <= 6, "of 60; 3 are expected"
    assert missed_by_half > 6, "an interval half as wide is found out"
    assert missed_by_cycles > 6, (
        "so is one that takes each cycle for itself: the late ones of a round are not independent"
    )


def test_few_rounds_give_no_interval(figures: ModuleType) -> None:
    few = [np.full(100, 1000)] * 7
    told = figures.ratio_figures("r", few, few)
    assert told["r"] == 1.0 and told["r_low"] == -math.inf and told["r_high"] == math.inf
