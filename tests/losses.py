# SPDX-License-Identifier: Apache-2.0
"""Does something cost the Spine ticks? Short windows around it are compared with others of the same run.

A stall of the machine that lasts 60 ticks is one event and not sixty, so windows with any loss are counted, and not
lost ticks. The machine's own stalls hit both kinds of windows alike; what the event itself costs hits only its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np
import numpy.typing as npt

SURE = 1e-4  # a difference this unlikely by chance is none


@dataclass(frozen=True)
class Comparison:
    """Windows in which a release was skipped, of all windows: at the events, and between them."""

    at_events: int
    events: int
    between: int
    others: int

    @property
    def chance(self) -> float:
        """How likely at least so many losses fall to the events if they cost nothing (Fisher's exact test)."""
        lossy = self.at_events + self.between
        ways = sum(
            comb(self.events, hit) * comb(self.others, lossy - hit)
            for hit in range(self.at_events, min(self.events, lossy) + 1)
        )
        return ways / comb(self.events + self.others, lossy)

    @property
    def costs_ticks(self) -> bool:
        """Whether the events cost ticks beyond reasonable doubt."""
        return self.chance < SURE

    @property
    def would_show(self) -> int:
        """The least number of events with a loss that would have been beyond doubt in this run."""
        hits = self.between
        while hits < self.events and not Comparison(hits, self.events, self.between, self.others).costs_ticks:
            hits += 1
        return hits

    def __str__(self) -> str:
        """The two counts, and what they mean."""
        return (
            f"{self.at_events} of {self.events} windows with a lost tick, elsewhere {self.between} of {self.others}"
            f" (p = {self.chance:.2g}; {self.would_show} would have failed)"
        )


def lossy_windows(records: npt.NDArray[Any], first_ticks: npt.NDArray[np.int64], length: int) -> int:
    """How many windows of `length` ticks, from each of `first_ticks` on, hold a skipped release."""
    ticks = records["tick"].astype(np.int64)
    missed = records["missed_releases"].astype(np.int64)
    # A release skipped before a tick is in that tick's own count.
    before = missed[np.searchsorted(ticks, first_ticks) - 1]
    after = missed[np.searchsorted(ticks, first_ticks + length) - 1]
    return int((after > before).sum())


def compare(records: npt.NDArray[Any], first_ticks: npt.NDArray[np.int64], length: int) -> Comparison:
    """Windows at events beside as long ones in the middle between two of them, wherever those do not touch."""
    ticks = records["tick"].astype(np.int64)
    first = np.unique(first_ticks)
    first = first[(first > ticks[0]) & (first + length <= ticks[-1])]
    gaps = np.diff(first)
    between = (first[:-1] + gaps // 2)[gaps >= 2 * length]
    return Comparison(
        lossy_windows(records, first, length), len(first), lossy_windows(records, between, length), len(between)
    )
