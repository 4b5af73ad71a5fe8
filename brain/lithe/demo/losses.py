# SPDX-License-Identifier: Apache-2.0
"""Which releases were missed, how late every one of them was, and whether something that happened has to do with it.

Short windows around the events are compared with others of the same run. A stall of the machine that lasts 60 ticks is
one event and not sixty, so windows with any loss are counted, and not lost ticks. The machine's own stalls hit both
kinds of windows alike; what the event itself costs hits only its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from math import comb
from typing import Any

import numpy as np
import numpy.typing as npt

from lithe._wire import TelemetryFlags

Integers = npt.NDArray[np.int64]
Window = tuple[int, int]  # from, to [ns]


@dataclass(frozen=True)
class Releases:
    """Every release of a recording, in order of time, those at which no tick ran among them."""

    due_ns: Integers
    late_ns: Integers
    skipped: npt.NDArray[np.bool_]

    def lost_in(self, window: Window) -> int:
        """Releases due in the window at which no tick ran."""
        first, end = np.searchsorted(self.due_ns, window)
        return int(np.count_nonzero(self.skipped[first:end]))


def _skips(records: npt.NDArray[Any]) -> Integers:
    """Releases that were skipped before each tick."""
    total = records["missed_releases"].astype(np.int64)
    return np.diff(total, prepend=total[:1])


def releases(records: npt.NDArray[Any], period_ns: int) -> Releases:
    """A skipped release is late by all the time until the tick that ran instead, as in bench/rig/cycles.hpp."""
    due_ns = records["release_ns"].astype(np.int64)
    late_ns = records["release_jitter_ns"].astype(np.int64)
    skips = _skips(records)
    instead = np.repeat(np.arange(len(records)), skips)  # the tick that ran instead of each skipped release
    behind_ns = (np.repeat(np.cumsum(skips), skips) - np.arange(len(instead))) * period_ns
    all_due_ns = np.concatenate((due_ns[instead] - behind_ns, due_ns))
    order = np.argsort(all_due_ns, kind="stable")
    return Releases(
        due_ns=all_due_ns[order],
        late_ns=np.concatenate((late_ns[instead] + behind_ns, late_ns))[order],
        skipped=np.concatenate((np.ones(len(instead), bool), np.zeros(len(due_ns), bool)))[order],
    )


def with_missed_deadlines(made: Releases, records: npt.NDArray[Any]) -> Releases:
    """The same releases; those whose tick ended after its deadline count as missed too, though none was skipped."""
    due_ns = records["release_ns"].astype(np.int64)
    # The flag comes with the next tick.
    ended_late = np.roll((records["flags"] & TelemetryFlags.deadline_missed != 0) & (_skips(records) == 0), -1)
    ended_late[-1:] = False
    return replace(made, skipped=made.skipped | np.isin(made.due_ns, due_ns[ended_late]))


def slices(span: Window, length_ns: int) -> list[Window]:
    """All of a span, cut into windows of that length; the last one takes the rest."""
    count = max(1, (span[1] - span[0]) // length_ns)
    edges = [span[0] + i * length_ns for i in range(count)] + [span[1]]
    return list(pairwise(edges))


def commit_ns(records: npt.NDArray[Any], tick: int) -> int:
    """When the tick was due that adopted a law."""
    at = int(np.searchsorted(records["tick"].astype(np.int64), tick))
    return int(records["release_ns"][min(at, len(records) - 1)])


def elsewhere(span: Window, taken: list[Window], length_ns: int) -> list[Window]:
    """Windows of exactly that length in what `taken` leaves of the span, as many as fit."""
    windows: list[Window] = []
    start = span[0]
    for left, right in [*sorted(taken), (span[1], span[1])]:
        count = max(0, (left - start) // length_ns)
        first = start + (left - start - count * length_ns) // 2
        windows += [(first + i * length_ns, first + (i + 1) * length_ns) for i in range(count)]
        start = max(start, right)
    return windows


def tally(made: Releases, windows: list[Window]) -> dict[str, float]:
    """Lost ticks of some windows, and how many that is per second."""
    lost = [made.lost_in(window) for window in windows]
    seconds = sum(b - a for a, b in windows) * 1e-9
    return {
        "windows": len(windows),
        "seconds": seconds,
        "lost_ticks": sum(lost),
        "windows_with_loss": int(np.count_nonzero(lost)),
        "lost_per_s": sum(lost) / seconds if seconds > 0 else float("nan"),
    }


@dataclass(frozen=True)
class Comparison:
    """Windows in which a release was skipped, of all windows of one length: at the events, and where there is none."""

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

    def would_show(self, least_chance: float) -> int:
        """The least number of events with a loss that would have been less likely than that; one more if none."""
        hits = 0
        while hits <= self.events and Comparison(hits, self.events, self.between, self.others).chance >= least_chance:
            hits += 1
        return hits


def compare(made: Releases, events: list[Window], others: list[Window]) -> Comparison:
    """Both kinds of windows of one run; they should be of one length."""
    at_events, between = (sum(made.lost_in(window) > 0 for window in windows) for windows in (events, others))
    return Comparison(at_events, len(events), between, len(others))
