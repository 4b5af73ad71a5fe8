# SPDX-License-Identifier: Apache-2.0
"""The ratio of lateness with and without an agent, on rounds whose ratio is known."""

import numpy as np
import pytest

from bench.agent.__main__ import PAUSE_S, ratio_interval, requests_per_s


def rounds(late_bin: int, count: int, seed: int) -> list[np.ndarray]:
    """Rounds of 1000 releases of which five are late, about in that bin."""
    made = []
    for wander in np.random.default_rng(seed).integers(-3, 4, count):
        bins = np.zeros(600, dtype=np.int64)
        bins[100], bins[late_bin + int(wander)] = 995, 5
        made.append(bins)
    return made


@pytest.mark.parametrize("octaves", [0, 1])
def test_the_interval_holds_the_true_ratio_and_not_twice_it(octaves: int) -> None:
    low, middle, high = ratio_interval(rounds(300 + 32 * octaves, 24, 1), rounds(300, 24, 2))
    assert low is not None and middle is not None and high is not None
    assert low < middle < high and low <= 2.0**octaves <= high, (low, middle, high)
    assert high / low < 1.2, "24 rounds that differ by a tenth tell more than that"


def test_too_few_rounds_tell_no_interval() -> None:
    low, middle, high = ratio_interval(rounds(300, 4, 1), rounds(300, 4, 2))
    assert low is None and high is None and middle is not None


def test_requests_are_counted_over_all_the_time_in_which_the_agent_asks() -> None:
    assert PAUSE_S == 0.3 and requests_per_s(6600, rounds=20, block_s=3.0) == pytest.approx(100)
