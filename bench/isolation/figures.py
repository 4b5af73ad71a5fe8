# SPDX-License-Identifier: Apache-2.0
"""The figures of `make bench-isolation`, from the records of every release.

`Rounds` has the records of one program under one workload, one array for each round. Steal-aware figures leave out what
the hypervisor took. For LITHE and the floor that is known for each release. A program that sleeps cannot know it: of
its round, as many of the latest cycles are left out as the stolen time of the round can explain, in favour of the
program.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.swap.stats import LEAST_ROUNDS, LIMITS_US, permutation_interval
from bench.tables import Figures

# Record of bench/isolation/spine.cpp
RECORD = np.dtype(
    [
        *((name, "<i8") for name in ("late_ns", "stolen_ns", "handoff_ns", "release_ns", "work_ns", "page_ns")),
        *((name, "<u2") for name in ("switches", "sleeps")),
        *((name, "u1") for name in ("program", "missed")),
        ("told", "<u2"),
    ]
)
FLOOR, LITHE, CONTROL, CYCLICTEST, WRITING = range(5)  # the program's number in a record
PEERS = ("cyclictest", "plain_loop", "moteus_loop")
# `page`, `ours`: it passed while the tick before it still ran; `page` when that tick spent most of the delay with a
# touch of the pages of its telemetry record. `kernel_thread`, `tick` and `interrupt` are told by a trace only
# (bench/isolation/attribution.py). Without one, a release before which there was a switch is counted at `other_task`.
# `unknown`: none of these. A bare spin, which has no work of its own, shows how many the machine itself makes.
CAUSES = ("hypervisor", "kernel_thread", "tick", "interrupt", "other_task", "page", "ours", "unknown")
PERIOD_NS = 1_000_000
LEAST_US = 1.0  # smaller differences are not significant
RESAMPLES = 200
Records = npt.NDArray[Any]
Rounds = list[Records]
Late = npt.NDArray[np.int64]  # [ns]


def peer_records(late_ns: list[int] | Late, stolen_ns: int) -> Records:
    """Records of a peer's round. `stolen_ns`: what the hypervisor took from its cores in that time."""
    records = np.zeros(len(late_ns), RECORD)
    records["late_ns"], records["handoff_ns"], records["work_ns"] = late_ns, -1, -1
    explained = min(-(-stolen_ns // PERIOD_NS), len(records))
    if explained:
        records["stolen_ns"][np.argsort(records["late_ns"])[-explained:]] = np.iinfo(np.int64).max
    return records


def kernel_share(before: tuple[int, int], after: tuple[int, int]) -> float:
    """The stolen share of a core's time between two answers of stolen_ticks(); NaN when no time has passed."""
    taken, ticks = (b - a for a, b in zip(before, after, strict=True))
    return taken / ticks if ticks > 0 else math.nan


def stolen(records: Records) -> npt.NDArray[np.bool_]:
    """Whose time the hypervisor took: as in bench/rig/cycles.hpp."""
    kept = (records["switches"] == 0) & (records["sleeps"] == 0)
    found: npt.NDArray[np.bool_] = kept & (records["stolen_ns"] > np.maximum(5000, records["late_ns"] // 2))
    return found


def cause(records: Records) -> npt.NDArray[np.int64]:
    """Index in CAUSES for each release; `told` of a record is that index plus 1, or 0 where nothing is told."""
    guessed = np.where(records["switches"] > 0, CAUSES.index("other_task"), CAUSES.index("unknown"))
    return np.where(stolen(records), 0, np.where(records["told"] > 0, records["told"].astype(np.int64) - 1, guessed))


def of_work(records: Records) -> Records:
    """The same releases, those at which something ran, by how long that took (`late_ns`) and by what made it long:
    ours, unless another task ran, or a touch of the pages took more than half of it.
    """
    seen = records[records["work_ns"] >= 0]
    seen["late_ns"] = seen["work_ns"]
    paged = seen["page_ns"] > seen["work_ns"] // 2
    told = np.where(paged, CAUSES.index("page"), CAUSES.index("ours")) + 1
    seen["told"] = np.where(seen["switches"] > 0, 0, told)
    return seen


def missed_cause(missed: Records) -> npt.NDArray[np.int64]:
    """The same for missed deadlines: of a tick that began in time, but ended after the next release, by its work."""
    seen = missed.copy()
    began = (seen["late_ns"] < PERIOD_NS // 2) & (seen["work_ns"] >= 0)
    seen[began] = of_work(missed[began])
    seen["late_ns"][began] = PERIOD_NS  # its end was at least this late
    return cause(seen)


def calm(rounds: Rounds) -> list[Late]:
    """Lateness of each round without what the hypervisor took."""
    return [each["late_ns"][~stolen(each)] for each in rounds]


def raw(rounds: Rounds) -> list[Late]:
    """Lateness of each round, all of it."""
    return [each["late_ns"] for each in rounds]


def quantile_us(rounds: list[Late], q: float) -> float:
    """The lateness that the share q of all cycles does not exceed; NaN when there are none."""
    values = np.concatenate(rounds) if rounds else np.array([])
    return float(np.quantile(values, q, method="inverted_cdf")) / 1e3 if len(values) else math.nan


def quantiles(key: str, rounds: list[Late]) -> Figures:
    """p50, p99, p99.9 and max, as <key>_p50_us and so on."""
    named = {"p50": 0.5, "p99": 0.99, "p999": 0.999, "max": 1.0}
    return {f"{key}_{name}_us": quantile_us(rounds, q) for name, q in named.items()}


def ratio(over: list[Late], under: list[Late], q: float = 0.999) -> float:
    """Of two quantiles, each at least LEAST_US; NaN when one is missing."""
    a, b = quantile_us(over, q), quantile_us(under, q)
    return math.nan if math.isnan(a) or math.isnan(b) else max(a, LEAST_US) / max(b, LEAST_US)


def interval(of: Callable[[npt.NDArray[np.int64]], float], rounds: int) -> tuple[float, float]:
    """95 % interval: `of` is evaluated for rounds drawn at random, with repetition. Too few rounds: no limits."""
    if rounds < LEAST_ROUNDS:
        return -math.inf, math.inf
    draws = np.random.default_rng(1).integers(0, rounds, (RESAMPLES, rounds))
    values = np.array([of(draw) for draw in draws])
    return (math.nan, math.nan) if np.isnan(values).any() else tuple(np.percentile(values, [2.5, 97.5]).tolist())


def ratio_figures(key: str, over: list[Late], under: list[Late]) -> Figures:
    """The ratio and its interval; both sides are of the same rounds."""
    low, high = interval(
        lambda draw: ratio([over[i] for i in draw], [under[i] for i in draw]), min(len(over), len(under))
    )
    return {key: ratio(over, under), f"{key}_low": low, f"{key}_high": high}


def share_figures(key: str, rounds: list[Late]) -> Figures:
    """Shares of cycles later than each of LIMITS_US, and their intervals over the rounds."""
    told: Figures = {}
    for limit_us in LIMITS_US:
        shares = np.array([float(np.mean(each > limit_us * 1000)) for each in rounds if len(each)])
        low, high = interval(lambda draw, s=shares: float(s[draw].mean()), len(shares))  # type: ignore[misc]
        name = f"{key}_over_{limit_us}us"
        told |= {name: float(shares.mean()) if len(shares) else math.nan}
        told |= {f"{name}_low": max(low, 0.0), f"{name}_high": min(high, 1.0)}
    return told


def difference_figures(key: str, over: list[Late], under: list[Late]) -> Figures:
    """The same for the difference of two programs, paired by round."""
    told: Figures = {}
    pairs = [(a, b) for a, b in zip(over, under, strict=True) if len(a) and len(b)]
    for limit_us in LIMITS_US:
        limit_ns = limit_us * 1000
        differences = np.array([np.mean(a > limit_ns) - np.mean(b > limit_ns) for a, b in pairs], dtype=np.float64)
        low, high = permutation_interval(differences)
        name = f"{key}_over_{limit_us}us_difference"
        told |= {name: float(differences.mean()) if pairs else math.nan}
        told |= {f"{name}_low": low, f"{name}_high": high}
    return told


def cause_figures(key: str, rounds: Rounds) -> Figures:
    """How many cycles were later than each limit, by cause."""
    records = np.concatenate(rounds)
    causes = cause(records)
    return {
        f"{key}_over_{limit_us}us_{name}": int(np.count_nonzero((causes == i) & (records["late_ns"] > limit_us * 1000)))
        for limit_us in LIMITS_US
        for i, name in enumerate(CAUSES)
    }


def workload_figures(name: str, seen: dict[str, Rounds]) -> Figures:
    """All figures of one workload; `seen` has `floor`, `writing` and `lithe`, and the peers that are there."""
    floor, lithe = seen["floor"], seen["lithe"]
    both, own = np.concatenate(floor + lithe), np.concatenate(lithe)
    told = ratio_figures(f"r999_floor_{name}", calm(lithe), calm(floor))
    told |= difference_figures(f"late_{name}", calm(lithe), calm(floor))
    work = {program: [of_work(each) for each in seen[program]] for program in ("writing", "lithe")}
    told |= ratio_figures(f"r999_work_{name}", *(calm(work[each]) for each in ("lithe", "writing")))
    told |= difference_figures(f"work_{name}", *(calm(work[each]) for each in ("lithe", "writing")))
    for program, rounds in work.items():
        key = f"work_{program}_{name}"
        told |= quantiles(key, calm(rounds)) | share_figures(key, calm(rounds)) | cause_figures(key, rounds)
    told |= {
        f"r999_raw_floor_{name}": ratio(raw(lithe), raw(floor)),
        f"steal_share_{name}": float(np.mean(stolen(both))),
        f"preempted_share_{name}": float(np.mean(own["switches"] > 0)),
        f"floor_preempted_share_{name}": float(np.mean(np.concatenate(floor)["switches"] > 0)),
        f"cycles_{name}": len(own),
        f"rounds_{name}": len(lithe),
        f"missed_deadlines_{name}": int(np.count_nonzero(own["missed"])),
    }
    causes = missed_cause(own[own["missed"] > 0])
    told |= {f"missed_deadlines_{name}_{each}": int(np.count_nonzero(causes == i)) for i, each in enumerate(CAUSES)}
    done = [each[each["handoff_ns"] >= 0] for each in lithe]  # a skipped release has no hand-off
    told |= quantiles(f"handoff_{name}", [each["handoff_ns"][~stolen(each)] for each in done])
    told |= quantiles(f"handoff_raw_{name}", [each["handoff_ns"] for each in done])
    told |= {f"r999_{peer}_{name}": math.nan for peer in PEERS}  # unless it was seen
    for program, rounds in seen.items():
        told |= quantiles(f"{program}_{name}", calm(rounds)) | quantiles(f"{program}_raw_{name}", raw(rounds))
        told |= share_figures(f"{program}_{name}", calm(rounds))
        if program in ("floor", "writing", "lithe"):
            told |= cause_figures(f"{program}_{name}", rounds)
        if program in ("writing", *PEERS):
            told |= ratio_figures(f"r999_{program}_{name}", calm(lithe), calm(rounds))
            told |= {f"r999_raw_{program}_{name}": ratio(raw(lithe), raw(rounds))}
            told |= {f"cycles_{program}_{name}": sum(map(len, rounds))}
    return told
