# SPDX-License-Identifier: Apache-2.0
"""The comparison tells what an event costs from what the machine does anyway."""

import numpy as np
import pytest
from losses import Comparison, compare, lossy_windows

SWAPS = 1000
PERIOD = 30
WINDOW = 11
FIRST = 100 + PERIOD * np.arange(SWAPS, dtype=np.int64)


def run(lost_at: np.ndarray, lost: int = 1) -> np.ndarray:
    """Telemetry of a run that skipped `lost` releases before each of these ticks."""
    records = np.zeros(FIRST[-1] + 200, [("tick", np.uint64), ("missed_releases", np.uint32)])
    records["tick"] = np.arange(1, len(records) + 1)
    skipped = np.zeros(len(records), np.int64)
    np.add.at(skipped, lost_at - 1, lost)
    records["missed_releases"] = np.cumsum(skipped)
    return records


def machine_stalls(share: float, seed: int) -> np.ndarray:
    """Ticks before which a machine stalls that does not know of swaps."""
    random = np.random.default_rng(seed)
    return np.flatnonzero(random.random(FIRST[-1] + 100) < share / WINDOW) + 1


@pytest.mark.parametrize("share", [0.0, 0.01, 0.05])
def test_one_lost_tick_in_six_of_a_hundred_swaps_is_beyond_doubt(share: float) -> None:
    guilty = FIRST[np.random.default_rng(1).choice(SWAPS, 60, replace=False)] + 5
    told = compare(run(np.concatenate([guilty, machine_stalls(share, seed=2)])), FIRST, WINDOW)
    assert told.costs_ticks, str(told)


def test_a_swap_that_costs_nothing_is_never_accused() -> None:
    for seed in range(200):
        told = compare(run(machine_stalls(0.05, seed)), FIRST, WINDOW)
        assert not told.costs_ticks, str(told)


def test_a_run_without_a_loss_proves_innocence() -> None:
    told = compare(run(np.array([], np.int64)), FIRST, WINDOW)
    assert (told.at_events, told.between, told.chance) == (0, 0, 1.0)
    assert told.events == SWAPS
    assert told.others == SWAPS - 1
    assert told.would_show < 20, "of a thousand"


def test_a_stall_of_many_ticks_is_one_event() -> None:
    told = compare(run(FIRST[[500]] + 5, lost=60), FIRST, WINDOW)
    assert told.at_events == 1
    assert not told.costs_ticks


def test_losses_are_counted_where_they_are() -> None:
    records = run(np.array([100, 110, 111, 125, 140]))
    assert lossy_windows(records, np.array([100]), WINDOW) == 1
    assert lossy_windows(records, np.array([101]), 9) == 0, "110 is the first tick after it"
    assert lossy_windows(records, np.array([111]), 1) == 1
    assert lossy_windows(records, np.array([112]), 13) == 0
    assert lossy_windows(records, np.array([100, 112, 125]), WINDOW) == 2


def test_windows_that_would_touch_are_left_out() -> None:
    told = compare(run(np.array([], np.int64)), np.array([100, 121, 143, 165]), WINDOW)
    assert (told.events, told.others) == (4, 2), "21 ticks hold no window and a half beside another"


def test_the_exact_probability_is_fishers() -> None:
    # The lady tasting tea: 3 of 4 right by chance, and all 4.
    assert Comparison(3, 4, 1, 4).chance == pytest.approx(17 / 70)
    assert Comparison(4, 4, 0, 4).chance == pytest.approx(1 / 70)
