# SPDX-License-Identifier: Apache-2.0
"""Is a run of `make bench-swap` worth anything, and does what is claimed of a swap hold in it?

Every comparison is written so that a figure that is missing or no number fails it.
"""

from __future__ import annotations

from typing import Any

from bench import continuity
from bench.report import DISTURBED
from bench.swap_stats import LEAST_ROUNDS

Figures = dict[str, Any]
MOST_JITTER_RATIO = 1.1
PEERS = ("dlopen", "mutex", "brief")
# Null in an inconclusive run.
CLAIMS = ("lost_ticks_attributable", "jitter_p999_in_over_out", "output_p999_in_over_out")


def reasons_to_doubt(told: Figures) -> list[str]:
    """What makes this run worth nothing."""
    found = [
        f"{key} is {told[key]:.1%}, above {DISTURBED:.0%}"
        for key in ("stolen_share", "preempted_share")
        if not told[key] <= DISTURBED
    ]
    if not told["control_failed_as_it_must"]:
        found.append("the control (a compiler in the loop's thread) lost no ticks")
    if told["ticks_not_recorded"]:
        found.append(f"{told['ticks_not_recorded']} ticks were not recorded")
    if not told["rounds_compared"] >= LEAST_ROUNDS:
        found.append(f"only {told['rounds_compared']} rounds could be compared, of at least {LEAST_ROUNDS}")
    for key, wanted in (("loader", "arena"), ("loader_dlopen_loader", "dlopen")):
        if told[key] != wanted:
            found.append(f"{key} is {told[key]} and not {wanted}")
    return found


def jitter(told: Figures) -> str:
    """The ratio and its interval."""
    low, high = (told[f"jitter_p999_in_over_out_{end}"] for end in ("low", "high"))
    return f"{told['jitter_p999_in_over_out']:.2f} ({low:.2f} .. {high:.2f})"


def undecided(told: Figures) -> list[str]:
    """What this run neither shows nor refutes."""
    if told["jitter_p999_in_over_out"] <= MOST_JITTER_RATIO:
        return []
    return [f"jitter p99.9 while swapping is {jitter(told)} times that at rest: too uneven a machine to tell"]


def shortcomings(told: Figures) -> list[str]:
    """What is claimed of a swap and does not hold here, or was not done."""
    found = []
    wanted = told["swaps_wanted"]
    if not told["certificates"] == told["swaps"] == told["swaps_asked"] == wanted:
        done = f"{told['swaps_asked']} asked, {told['swaps']} done, {told['certificates']} certified"
        found.append(f"{wanted} swaps wanted, {done}")
    for name in PEERS:
        if told[f"peer_{name}_swaps"] != wanted:
            found.append(f"peer {name} did {told[f'peer_{name}_swaps']} of {wanted} swaps")
    if told["swaps_rolled_back"] != 0:
        found.append(f"{told['swaps_rolled_back']} swaps were rolled back by their probation")
    for key in ("safe_stops", "loader_dlopen_safe_stops"):
        if told[key] != 0:
            found.append(f"{key} is {told[key]}: swaps that follow a stop cost a robot that stands still nothing")
    if not told["lost_rate_difference_low_per_s"] <= 0:
        found.append("ticks are lost more often while swapping")
    if not told["jitter_p999_in_over_out_low"] <= MOST_JITTER_RATIO:
        found.append(f"jitter p99.9 while swapping is {jitter(told)} times that at rest")
    if not told["max_output_step_nm"] <= told["slew_bound_nm"] + 1e-9:
        found.append("a torque step was larger than the slew bound")
    if not (told["continuity_step_ratio"] or 0) >= continuity.LEAST_RATIO:
        found.append(f"a cold swap's step is less than {continuity.LEAST_RATIO:.0f} times LITHE's")
    return found
