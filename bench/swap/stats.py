# SPDX-License-Identifier: Apache-2.0
"""Do swaps cost ticks? Compares windows with swaps and windows without, all of equal length."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import comb
from typing import Any

import numpy as np
import numpy.typing as npt
from lithe.demo.losses import Comparison, Releases, Window, elsewhere

from bench.tables import Figures

WINDOW_NS = 50_000_000
AFTER_NS = 50_000_000  # a swap's window is from its request to this time after its commit
BURST_NS = 5_000_000  # a pause of the machine takes every tick; two swaps are further apart
AFTER_LOSS_TICKS = 2  # the law that runs late uses the old sample; the next one jumps to the new one
SIGNS = 4000
SURE = 0.95
LEAST_ROUNDS = 8  # with fewer, no difference could be refuted
LIMITS_US = (1, 5, 20, 100)  # ticks that are later than this are counted
NONE_SEEN = 3.69  # upper limit of the expected count when no event was seen (Poisson, 2.5 % on both sides)
Spans = npt.NDArray[np.int64]  # (n, 2): from, to [ns]


@dataclass
class Round:
    """One group of swaps, and the pause after it; LITHE's has trials without a swap between them."""

    swapping: Window  # from the first request to AFTER_NS after the last commit
    resting: Window
    swaps: int
    trying: Window = (0, 0)  # laws are tried and refused: the work of swaps on the other cores, and no swap

    def beside_trials(self) -> Round:
        """The same swaps, to be compared with the trials."""
        return replace(self, resting=self.trying)


def windows(spans: list[Window]) -> Spans:
    """Windows of WINDOW_NS, as many as fit into each span."""
    cut = [window for span in spans for window in elsewhere(span, [], WINDOW_NS)]
    return np.array(cut, dtype=np.int64).reshape(-1, 2)


def counts_in(at_ns: npt.NDArray[np.int64], spans: Spans) -> npt.NDArray[np.int64]:
    """How many of the sorted times are in each span."""
    counts: npt.NDArray[np.int64] = np.searchsorted(at_ns, spans[:, 1]) - np.searchsorted(at_ns, spans[:, 0])
    return counts


def untouched(spans: Spans, by: list[Window]) -> Spans:
    """The spans that do not overlap any of `by`."""
    keep = np.ones(len(spans), dtype=bool)
    for left, right in by:
        keep &= (spans[:, 1] <= left) | (spans[:, 0] >= right)
    kept: Spans = spans[keep]
    return kept


def inside(at_ns: npt.NDArray[np.int64], spans: Spans) -> npt.NDArray[np.bool_]:
    """Which times are in any of the spans; the spans do not overlap."""
    if not len(spans):
        return np.zeros(len(at_ns), dtype=bool)
    ordered = spans[np.argsort(spans[:, 0])]
    before = np.searchsorted(ordered[:, 0], at_ns, side="right") - 1
    found: npt.NDArray[np.bool_] = (before >= 0) & (at_ns < ordered[np.maximum(before, 0), 1])
    return found


def permutation_interval(differences: npt.NDArray[np.float64], sure: float = SURE) -> tuple[float, float]:
    """Confidence interval of the mean difference, from a permutation test: all values x that it does not refute.

    If a swap costs x, then the difference of a round minus x has either sign with the same probability. So the test
    exchanges swaps and rest within rounds at random.
    """
    n = len(differences)
    if n < LEAST_ROUNDS:
        return float("-inf"), float("inf")
    signs = np.random.default_rng(1).choice(np.array([-1.0, 1.0]), size=(SIGNS, n))
    shuffled, drift, mean = signs @ differences / n, signs.mean(axis=1), differences.mean()

    def refuted(x: float) -> bool:
        at_least = np.abs(shuffled - x * drift) >= abs(mean - x) - 1e-12
        return (1 + np.count_nonzero(at_least)) / (1 + SIGNS) < 1 - sure

    def edge(direction: float) -> float:
        inner, step = 0.0, max(float(np.abs(differences).max()), 1e-9) / n
        while not refuted(mean + direction * (inner + step)):
            inner += step
            step *= 2
        for _ in range(40):
            step /= 2
            inner += 0.0 if refuted(mean + direction * (inner + step)) else step
        return float(mean + direction * inner)

    return edge(-1.0), edge(1.0)


def bursts(lost_ns: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """When each pause began: ticks lost less than BURST_NS apart are lost in one."""
    return lost_ns[np.diff(lost_ns, prepend=lost_ns[:1] - BURST_NS) >= BURST_NS]


def chance_of(hits: int, of: int, share: float) -> float:
    """Probability that at least `hits` of `of` events are in this share of the time, if they occur at random times."""
    return float(sum(comb(of, k) * share**k * (1 - share) ** (of - k) for k in range(hits, of + 1)))


@dataclass
class Sides:
    """Windows with and without swaps, and the ticks lost in each."""

    rounds: list[Round]
    made: Releases
    without: list[Window] = field(default_factory=list)  # windows that overlap these are left out

    def __post_init__(self) -> None:
        self.lost_ns = self.made.due_ns[self.made.skipped]
        self.swapping = untouched(windows([each.swapping for each in self.rounds]), self.without)
        self.resting = untouched(windows([each.resting for each in self.rounds]), self.without)

    def differences_per_s(self) -> npt.NDArray[np.float64]:
        """Lost ticks per second while swapping, minus those at rest, for each round."""
        found = []
        for each in self.rounds:
            both = [untouched(windows([span]), self.without) for span in (each.swapping, each.resting)]
            if all(len(spans) for spans in both):
                a, b = (counts_in(self.lost_ns, spans).sum() / (len(spans) * WINDOW_NS * 1e-9) for spans in both)
                found.append(a - b)
        return np.array(found, dtype=np.float64)

    def lost(self) -> Figures:
        """Both counts, the interval of their difference, and what of it swaps have to answer for."""
        counts = [counts_in(self.lost_ns, spans) for spans in (self.swapping, self.resting)]
        seconds = [len(spans) * WINDOW_NS * 1e-9 for spans in (self.swapping, self.resting)]
        differences = self.differences_per_s()
        low, high = permutation_interval(differences)
        if not self.rounds or not any(count.any() for count in counts):
            low, high = (-NONE_SEEN / max(seconds[1], 1e-9), NONE_SEEN / max(seconds[0], 1e-9))
        told = Comparison(
            int(np.count_nonzero(counts[0])), len(counts[0]), int(np.count_nonzero(counts[1])), len(counts[1])
        )
        expected = counts[1].sum() * seconds[0] / seconds[1] if seconds[1] > 0 else float("nan")
        excess = float(counts[0].sum() - expected)
        # A pause of the machine loses many ticks, and rest is shorter than swapping: the interval alone would attribute
        # a few pauses to the swaps. So pauses are counted too, in relation to the time of each side.
        began = [int(counts_in(bursts(self.lost_ns), spans).sum()) for spans in (self.swapping, self.resting)]
        chance = chance_of(began[0], sum(began), seconds[0] / max(sum(seconds), 1e-9))
        own = low > 0 and chance < (1 - SURE) / 2
        return {
            "lost_ticks_in": int(counts[0].sum()),
            "lost_ticks_out": int(counts[1].sum()),
            "lost_ticks_excess": excess,
            "lost_ticks_attributable": max(0, round(excess)) if own else 0,
            "lost_bursts_in": began[0],
            "lost_bursts_out": began[1],
            "lost_bursts_chance": chance,
            "lost_rate_difference_low_per_s": low,
            "lost_rate_difference_high_per_s": high,
            "windows_in": len(counts[0]),
            "windows_out": len(counts[1]),
            "lossy_windows_in": told.at_events,
            "lossy_windows_out": told.between,
            "lossy_windows_chance": told.chance,
            "rounds_compared": len(differences),
            "seconds_in": seconds[0],
            "seconds_out": seconds[1],
        }

    def late_us(self, late_ns: npt.NDArray[np.int64], at_ns: npt.NDArray[np.int64], name: str) -> Figures:
        """p50, p99 and p99.9 of a delay on both sides. They depend strongly on disturbances by the host; use
        shares() for a verdict.
        """
        told: Figures = {}
        for side, spans in (("in", self.swapping), ("out", self.resting)):
            values = late_ns[inside(at_ns, spans)]
            quantiles = np.percentile(values, [50, 99, 99.9]) if len(values) else np.full(3, np.nan)
            told |= {f"{name}_{q}_{side}_us": v / 1e3 for q, v in zip(("p50", "p99", "p999"), quantiles, strict=True)}
        return told

    def shares(self, late_ns: npt.NDArray[np.int64], at_ns: npt.NDArray[np.int64], name: str) -> Figures:
        """Share of ticks that are later than each of LIMITS_US, on both sides; their difference, and its interval.

        The difference is the mean over the rounds; each round compares its swaps with its own rest.
        """
        pairs = [
            [inside(at_ns, untouched(windows([span]), self.without)) for span in (each.swapping, each.resting)]
            for each in self.rounds
        ]
        pairs = [pair for pair in pairs if all(chosen.any() for chosen in pair)]
        told: Figures = {}
        for limit_us in LIMITS_US:
            late = late_ns > limit_us * 1000
            shares = np.array([[late[chosen].mean() for chosen in pair] for pair in pairs]).reshape(-1, 2)
            low, high = permutation_interval(shares[:, 0] - shares[:, 1])
            means = shares.mean(axis=0) if len(shares) else np.full(2, np.nan)
            key = f"{name}_over_{limit_us}us"
            told |= {f"{key}_in": float(means[0]), f"{key}_out": float(means[1])}
            told |= {f"{key}_difference": float(means[0] - means[1])}
            told |= {f"{key}_difference_low": low, f"{key}_difference_high": high}
        return told


def on_the_move(rounds: list[Round], ticks: npt.NDArray[Any]) -> list[Round]:
    """The rounds in which the law ran in every tick: a stopped robot is no evidence about a swap."""
    still_ns = np.sort(ticks["release_ns"][~ticks["active"]])
    spans = np.array([(each.swapping[0], each.resting[1]) for each in rounds], dtype=np.int64).reshape(-1, 2)
    return [each for each, still in zip(rounds, counts_in(still_ns, spans), strict=True) if not still]


def stops_in(ticks: npt.NDArray[Any]) -> int:
    """How often the robot stopped running its law."""
    return int(np.count_nonzero(ticks["active"][:-1] & ~ticks["active"][1:]))


def largest_step_nm(ticks: npt.NDArray[Any], spans: list[Window] | Spans | None = None) -> float:
    """The largest torque step from one tick to the next, if the law ran in both; in some spans only, if they are given.

    Steps over a missed release are left out, and those of AFTER_LOSS_TICKS ticks after it, because the robot moved
    meanwhile and a law's sample is one exchange old: the first sample from after a pause comes a tick later. (The Spine
    numbers only the ticks that it ran, so tick numbers do not show a missed release.)
    """
    apart_ns = np.diff(ticks["release_ns"])
    ran = (ticks["active"][1:] & ticks["active"][:-1]) & (np.diff(ticks["tick"]) == 1)
    if len(apart_ns):
        missed = apart_ns >= 1.5 * np.median(apart_ns)
        for later in range(1 + AFTER_LOSS_TICKS):
            ran[later:] &= ~missed[: len(missed) - later]
    if spans is not None:
        ran &= inside(ticks["release_ns"][1:], np.array(spans, dtype=np.int64).reshape(-1, 2))
    steps = np.abs(np.diff(ticks["torque_nm"]))[ran]
    return float(steps.max()) if len(steps) else float("nan")
