# SPDX-License-Identifier: Apache-2.0
"""Is a run of `make bench-isolation` valid, and is LITHE as good as its core and far better than its peers?

Every comparison fails when its figure is missing or NaN.
"""

from __future__ import annotations

import math

from bench.isolation.attribution import TRACEFS
from bench.isolation.loads import APT, WORKLOADS
from bench.report import DISTURBED
from bench.swap.stats import LIMITS_US
from bench.tables import Figures

MOST_OVER_FLOOR = 1.1
MOST_OVER_PEER = 0.1
MOST_LATER = 0.001  # of the cycles: how many more of LITHE's than of the floor's may be later than a limit
JUDGED_PEERS = ("cyclictest", "plain_loop")
LEAST_CYCLES = 10_000  # of LITHE and of each judged peer in each workload: ten beyond p99.9
CONTROL_AT_LEAST = 20.0

SHIELD = "`--shield` takes the Spine's core from all other tasks for this run (needs root, undone at the end)"
BOOT = "isolate the Spine's core at boot: `lithe tune plan`"
HOST = "measure on bare metal, or where the hypervisor gives this guest its cores; leave one core idle"
MISSING = f"{APT} rt-tests"
LONGER = "measure longer: `--seconds 60` or more, or `--paper`"
TRACED = f"measure as root, after `mount -t tracefs nodev {TRACEFS}`"
ALL = "leave out `--workload`"


def number(told: Figures, key: str) -> float:
    """A figure; NaN when it is missing."""
    value = told.get(key)
    return math.nan if value is None else float(value)


def doubts(told: Figures, workloads: list[str]) -> list[tuple[str, str]]:
    """The reasons why this run is INCONCLUSIVE, and what would help against each."""
    left_out = [name for name in WORKLOADS if name not in workloads]
    found = [(f"not measured: {', '.join(left_out)}", ALL)] if left_out else []
    quieter = BOOT if told.get("shielded") else SHIELD
    for name in workloads:
        for key, words, remedy in (
            (f"steal_share_{name}", "stolen by the hypervisor", HOST),
            (f"steal_share_kernel_{name}", "stolen by the hypervisor, as the kernel counts", HOST),
            (f"floor_preempted_share_{name}", "of the floor preempted by other tasks", quieter),
        ):
            if not number(told, key) <= DISTURBED:
                found.append((f"{name}: {number(told, key):.1%} {words}, above {DISTURBED:.0%}", remedy))
        if not number(told, f"cycles_{name}") >= LEAST_CYCLES:
            found.append((f"{name}: {number(told, f'cycles_{name}'):.0f} cycles, {LEAST_CYCLES} are needed", LONGER))
        for peer in JUDGED_PEERS:
            if math.isnan(number(told, f"r999_{peer}_{name}")):
                why = told.get(f"{peer}_absent") or "no figure"
                found.append(
                    (f"{name}: no {peer} ({why})", MISSING if peer == "cyclictest" else "make bench-isolation")
                )
            elif not (cycles := number(told, f"cycles_{peer}_{name}")) >= LEAST_CYCLES:
                found.append((f"{name}: {cycles:.0f} cycles of {peer}, {LEAST_CYCLES} are needed", LONGER))
        if name == "swap":  # one in each round; the last offer may not have been taken
            rounds = number(told, "rounds_swap")
            if not (number(told, "rig_offers") > rounds and number(told, "second_robot_swaps") >= rounds):
                words = f"{number(told, 'rig_offers'):.0f} offers, {number(told, 'second_robot_swaps'):.0f} swaps"
                found.append(
                    (f"swap: {words} of the second robot in {rounds:.0f} rounds", f"read {told.get('loads_log')}")
                )
        if name == "numpy" and (told.get("rogue_ended") or not told.get("rogue_looks")):
            found.append(("numpy: the rogue program was not seen to run", f"read {told.get('loads_log')}"))
        if told.get(f"load_ended_{name}"):
            found.append((f"{name}: the load ended by itself", f"read {told.get('loads_log')}"))
        if told.get(f"shield_lost_{name}"):
            found.append((f"{name}: the shield was lowered during the run", "measure again, and leave the shield up"))
    apart = told.get("machine_irq_time_accounting")
    stolen = any(number(told, f"steal_share_{name}") > 0 for name in workloads)
    if apart is not False and told.get("untraced_blocks") != 0 and stolen:
        words = "leaves interrupts out of a thread's time" if apart else "has no configuration to read"
        found.append((f"stolen time may be that of interrupts: the kernel {words}, and no whole trace tells", TRACED))
    if not number(told, "control_over_floor") >= CONTROL_AT_LEAST:
        ratio = number(told, "control_over_floor")
        words = f"the negative control did not fail: {ratio:.1f} x the floor, at least {CONTROL_AT_LEAST:.0f} expected"
        found.append((words, quieter))
    return found


def later(told: Figures, name: str, end: str) -> list[str]:
    """The limits at which more than MOST_LATER of LITHE's cycles may be later (`end` high) or surely are (low)."""
    found = []
    for limit_us in LIMITS_US:
        key = f"late_{name}_over_{limit_us}us_difference"
        if not number(told, f"{key}_{end}") <= MOST_LATER:
            low, high = (number(told, f"{key}_{each}") for each in ("low", "high"))
            found.append(f"later than {limit_us} us: {number(told, key):+.3%} ({low:+.3%} .. {high:+.3%})")
    return found


def over_floor(told: Figures, name: str) -> str:
    """`holds`, `falls short`, or `undecided`.

    Where the host's own noise is at the quantile, its interval reaches over the limit: then the shares decide.
    """
    value, low, high = (number(told, f"r999_floor_{name}{end}") for end in ("", "_low", "_high"))
    if math.isnan(value) or low > MOST_OVER_FLOOR or later(told, name, "low"):
        return "falls short"
    if value <= MOST_OVER_FLOOR and (high <= MOST_OVER_FLOOR or not later(told, name, "high")):
        return "holds"
    return "undecided"


def shortcomings(told: Figures, workloads: list[str]) -> list[str]:
    """The claims that do not hold here."""
    found = []
    for name in workloads:
        if over_floor(told, name) == "falls short":
            words = f"{name}: {number(told, f'r999_floor_{name}'):.2f} x the floor, at most {MOST_OVER_FLOOR}"
            found.append("; ".join([words, *later(told, name, "low")]))
        for peer in JUDGED_PEERS:
            value, low = (number(told, f"r999_{peer}_{name}{end}") for end in ("", "_low"))
            if not low <= MOST_OVER_PEER and not spin_over_peer(told, peer, name) > MOST_OVER_PEER:
                found.append(f"{name}: {value:.3f} x {peer}, at most {MOST_OVER_PEER}")
    return found


def spin_over_peer(told: Figures, peer: str, name: str) -> float:
    """The floor's p99.9 over a peer's. Above MOST_OVER_PEER, no program could have held the claim here."""
    return number(told, f"r999_{peer}_{name}") / number(told, f"r999_floor_{name}")


def undecided_peers(told: Figures, name: str) -> list[tuple[str, str]]:
    """The peers that a program which only spins does not beat here either, or whose interval holds the limit."""
    found = []
    for peer in JUDGED_PEERS:
        value, low, high = (number(told, f"r999_{peer}_{name}{end}") for end in ("", "_low", "_high"))
        if not value <= MOST_OVER_PEER and spin_over_peer(told, peer, name) > MOST_OVER_PEER:
            found.append((f"{name}: a bare spin is itself {spin_over_peer(told, peer, name):.2f} x {peer} here", HOST))
        elif not high <= MOST_OVER_PEER:
            words = f"{name}: {value:.3f} x {peer}, but its interval is {low:.3f} to {high:.3f}, the limit"
            found.append((f"{words} {MOST_OVER_PEER}", LONGER))
    return found


def judge(told: Figures, workloads: list[str]) -> Figures:
    """`verdict`: holds, falls short or INCONCLUSIVE; with `reason`, and `conclusive_with`: what would help."""
    found = doubts(told, workloads)
    if not found:
        if short := shortcomings(told, workloads):
            return {"verdict": "falls short", "reason": "; ".join(short), "conclusive_with": ""}
        for name in workloads:
            found += undecided_peers(told, name)
            if over_floor(told, name) == "undecided":
                low, high = (number(told, f"r999_floor_{name}_{end}") for end in ("low", "high"))
                few = math.isinf(low)
                words = f"{name}: p99.9 over the floor's is undecided ({low:.2f} .. {high:.2f})"
                words = (
                    f"{name}: too few rounds for an interval" if few else "; ".join([words, *later(told, name, "high")])
                )
                found.append((words, LONGER if few or told.get("shielded") else SHIELD))
    if found:
        remedies = "; ".join(dict.fromkeys(remedy for _, remedy in found))
        return {"verdict": "INCONCLUSIVE", "reason": "; ".join(why for why, _ in found), "conclusive_with": remedies}
    return {"verdict": "holds", "reason": "", "conclusive_with": ""}
