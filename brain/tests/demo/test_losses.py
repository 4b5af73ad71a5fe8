# SPDX-License-Identifier: Apache-2.0
"""Lost releases are found where they were due, and what an event costs is told from what the machine does anyway."""

from itertools import pairwise

import numpy as np
import pytest
import synthetic
from lithe.demo.losses import (
    Comparison,
    Window,
    commit_ns,
    compare,
    elsewhere,
    releases,
    slices,
    tally,
    with_missed_deadlines,
)

MS = 1_000_000
SURE = 1e-4
SWAPS = 1000
PERIOD = 30
WINDOW = 11
FIRST = 100 + PERIOD * np.arange(SWAPS, dtype=np.int64)


def run(lost_at: np.ndarray, lost: int = 1, swaps: int = SWAPS) -> Comparison:
    """Telemetry at 1 kHz that skipped `lost` releases before each of these ticks, judged as a run of so many swaps."""
    records = np.zeros(
        FIRST[-1] + 200,
        [
            ("tick", np.uint64),
            ("missed_releases", np.uint32),
            ("release_ns", np.int64),
            ("release_jitter_ns", np.uint32),
        ],
    )
    records["tick"] = np.arange(1, len(records) + 1)
    skipped = np.zeros(len(records), np.int64)
    np.add.at(skipped, lost_at - 1, lost)
    records["missed_releases"] = np.cumsum(skipped)
    records["release_ns"] = (records["tick"].astype(np.int64) + np.cumsum(skipped)) * MS
    made = releases(records, MS)
    starts = [commit_ns(records, int(tick)) for tick in FIRST[:swaps]]
    windows = [(start, start + WINDOW * MS) for start in starts]
    span = (windows[0][0], windows[-1][1])
    return compare(made, windows, elsewhere(span, windows, WINDOW * MS))


def machine_stalls(share: float, seed: int) -> np.ndarray:
    """Ticks before which a machine stalls that does not know of swaps."""
    random = np.random.default_rng(seed)
    return np.flatnonzero(random.random(FIRST[-1] + 100) < share / WINDOW) + 1


@pytest.mark.parametrize("share", [0.0, 0.01, 0.05])
def test_one_lost_tick_in_six_of_a_hundred_swaps_is_beyond_doubt(share: float) -> None:
    guilty = FIRST[np.random.default_rng(1).choice(SWAPS, 60, replace=False)] + 5
    told = run(np.concatenate([guilty, machine_stalls(share, seed=3)]))
    assert told.chance < SURE, str(told)


def test_a_swap_that_costs_nothing_is_never_accused() -> None:
    for seed in range(60):
        told = run(machine_stalls(0.05, seed))
        assert told.chance >= SURE, str(told)


def test_a_run_without_a_loss_proves_innocence() -> None:
    told = run(np.array([], np.int64))
    assert (told.at_events, told.between, told.chance) == (0, 0, 1.0)
    assert (told.events, told.others) == (SWAPS, SWAPS - 1)
    assert told.would_show(SURE) < 20, "of a thousand"


def test_a_stall_of_many_ticks_is_one_event() -> None:
    told = run(FIRST[[500]] + 5, lost=60)
    assert told.at_events >= 1, "a stall of 60 ticks may reach into the window before"
    assert told.chance >= SURE


def test_the_exact_probability_is_fishers() -> None:
    # The lady tasting tea: 3 of 4 right by chance, and all 4.
    assert Comparison(3, 4, 1, 4).chance == pytest.approx(17 / 70)
    assert Comparison(4, 4, 0, 4).chance == pytest.approx(1 / 70)


def test_a_few_swaps_accuse_themselves_only_together() -> None:
    """A demo has five: one or two stalls that happen to fall into their windows are no proof, three are."""
    assert Comparison(2, 5, 0, 300).chance > 1e-4
    assert Comparison(2, 5, 3, 300).chance > 0.001
    assert Comparison(3, 5, 3, 300).chance < 0.001
    assert Comparison(0, 5, 3, 300).would_show(0.001) == 3
    assert Comparison(0, 5, 250, 300).would_show(0.001) == 6, "where nearly all windows lose, nothing can be told"


def test_a_skipped_release_is_late_until_the_tick_that_ran_instead() -> None:
    records = synthetic.records(10)
    records["release_jitter_ns"] = 100
    records["missed_releases"] = 2 * (records["tick"] >= 5)
    records["release_ns"] += 2 * MS * (records["tick"] >= 5).astype(np.int64)
    made = releases(records, MS)
    zero_ns = int(records["release_ns"][0])
    assert ((made.due_ns - zero_ns) // MS).tolist() == list(range(12))
    assert np.flatnonzero(made.skipped).tolist() == [5, 6]
    assert made.late_ns[5] == 2 * MS + 100 and made.late_ns[6] == MS + 100 and made.late_ns[7] == 100


def test_a_tick_that_ended_too_late_is_missed_as_a_skipped_one_is() -> None:
    """The next tick says so; with a skip it speaks of the skip, which is counted already."""
    records = synthetic.records(10)
    records["missed_releases"] = records["tick"] >= 5
    records["release_ns"] = 10**12 + (records["tick"].astype(np.int64) + records["missed_releases"]) * MS
    records["flags"][[3, 5]] = 512
    made = releases(records, MS)
    assert np.flatnonzero(made.skipped).tolist() == [5]
    assert np.flatnonzero(with_missed_deadlines(made, records).skipped).tolist() == [2, 5]


def test_slices_take_all_of_a_span() -> None:
    assert slices((0, 25), 10) == [(0, 10), (10, 25)]
    assert slices((5, 9), 10) == [(5, 9)]


def test_losses_are_counted_where_they_were_due() -> None:
    records = synthetic.records(100)
    late = np.zeros(100, np.int64)
    late[[40, 41, 60]] = (1, 2, 1)
    records["missed_releases"] = np.cumsum(late)
    records["release_ns"] += np.cumsum(late) * MS
    made, zero_ns = releases(records, MS), int(records["release_ns"][0])

    def lost(first_ms: int, end_ms: int) -> int:
        return made.lost_in((zero_ns + first_ms * MS, zero_ns + end_ms * MS))

    assert (lost(0, 40), lost(40, 41), lost(41, 42), lost(42, 44), lost(44, 63), lost(63, 64)) == (0, 1, 0, 2, 0, 1)
    counted = tally(made, [(zero_ns, zero_ns + 50 * MS), (zero_ns + 50 * MS, zero_ns + 200 * MS)])
    assert (counted["windows"], counted["windows_with_loss"], counted["lost_ticks"]) == (2, 2, 4)
    assert counted["lost_per_s"] == pytest.approx(20.0)


def test_windows_elsewhere_have_the_same_length_and_touch_no_event() -> None:
    taken: list[Window] = [(100, 150), (155, 160), (300, 390)]
    others = elsewhere((0, 420), taken, 40)
    assert {b - a for a, b in others} == {40}
    assert len(others) == 2 + 0 + 3 + 0, "a gap too short for one holds none"
    assert all(b <= left or a >= right for a, b in others for left, right in taken)
    assert all(b <= c for (_, b), (c, _) in pairwise(others))


@pytest.mark.parametrize("share", [0.0, 0.05])
def test_sixty_swaps_are_enough_to_refute_a_lost_tick_at_each_third(share: float) -> None:
    """As many as a robot of twelve joints is given; what is lost elsewhere in the run is the machine's."""
    swaps = 60
    end = int(FIRST[swaps - 1]) + 20
    stalls = machine_stalls(share, seed=5)
    calm = run(stalls[stalls < end], swaps=swaps)
    assert calm.chance >= SURE and calm.would_show(SURE) <= swaps // 3, str(calm)
    spoilt = run(np.concatenate([FIRST[:swaps:3] + 5, stalls[stalls < end]]), swaps=swaps)
    assert spoilt.chance < SURE, str(spoilt)
