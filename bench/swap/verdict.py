# SPDX-License-Identifier: Apache-2.0
"""Is a run of `make bench-swap` valid, and do the claims about a swap hold in it?

Every comparison fails when its figure is missing or NaN.
"""

from __future__ import annotations

from bench.report import DISTURBED
from bench.swap import continuity
from bench.swap.stats import LEAST_ROUNDS, LIMITS_US
from bench.tables import Figures

# Of the ticks: how many more may be later than a limit while swapping than beside the same trials without a swap.
MOST_LATER = 0.001
PEERS = ("dlopen", "mutex", "brief")
LATER = [f"trial_jitter_over_{limit_us}us_difference" for limit_us in LIMITS_US]
CLAIMS = ("lost_ticks_attributable", "lost_ticks_attributable_steal_aware", *LATER)  # null in an inconclusive run


def reasons_to_doubt(told: Figures) -> list[str]:
    """The reasons why this run is INCONCLUSIVE."""
    found = [
        f"{key} is {told[key]:.1%}, above {DISTURBED:.0%}"
        for key in ("stolen_share", "preempted_share")
        if not told[key] <= DISTURBED
    ]
    if not told["control_failed_as_it_must"]:
        found.append("the control (a compiler in the loop's thread) lost no ticks")
    if told["ticks_not_recorded"]:
        found.append(f"{told['ticks_not_recorded']} ticks were not recorded")
    if told["trials_not_refused"]:
        found.append(f"trials that must be refused ended otherwise: {told['trials_not_refused']}")
    if not told["rounds_compared"] >= LEAST_ROUNDS:
        found.append(f"only {told['rounds_compared']} rounds could be compared, of at least {LEAST_ROUNDS}")
    for key, wanted in (("loader", "arena"), ("loader_dlopen_loader", "dlopen")):
        if told[key] != wanted:
            found.append(f"{key} is {told[key]} and not {wanted}")
    return found


def later(told: Figures, limit_us: int) -> str:
    """The difference at one limit, and its interval."""
    key = f"trial_jitter_over_{limit_us}us_difference"
    low, high = (told[f"{key}_{end}"] for end in ("low", "high"))
    return (
        f"ticks later than {limit_us} us: {told[key]:+.3%} with swaps, beside trials alone ({low:+.3%} .. {high:+.3%})"
    )


def stepped(told: Figures) -> bool:
    """A torque step while swapping was larger than the guard of robots/arm.toml permits."""
    return not told["max_output_step_nm"] <= told["slew_bound_nm"]


def at_rest_too(told: Figures) -> bool:
    """The same without any swap: then the cause was not a swap."""
    return bool(told["max_output_step_at_rest_nm"] > told["slew_bound_nm"])


def undecided(told: Figures) -> list[str]:
    """The claims that this run neither confirms nor refutes."""
    steps = []
    if stepped(told) and at_rest_too(told):
        steps.append(
            f"the torque stepped by {told['max_output_step_nm']:.4f} N m while swapping, and by "
            f"{told['max_output_step_at_rest_nm']:.4f} at rest, after pauses of the machine: use a less busy machine"
        )
    return steps + [
        f"{later(told, limit_us)}; to decide about {MOST_LATER:+.1%}, use more rounds or a less busy machine"
        for limit_us, key in zip(LIMITS_US, LATER, strict=True)
        if not told[f"{key}_high"] <= MOST_LATER
    ]


def shortcomings(told: Figures) -> list[str]:
    """The claims about a swap that do not hold here, and what was not done."""
    found = []
    wanted = told["swaps_wanted"]
    if not told["certificates"] == told["swaps"] == told["swaps_asked"] == wanted:
        done = f"{told['swaps_asked']} requested, {told['swaps']} done, {told['certificates']} with a certificate"
        found.append(f"{wanted} swaps wanted, {done}")
    for name in PEERS:
        if told[f"peer_{name}_swaps"] != wanted:
            found.append(f"peer {name} did {told[f'peer_{name}_swaps']} of {wanted} swaps")
    if told["swaps_rolled_back"] != 0:
        found.append(f"{told['swaps_rolled_back']} swaps were rolled back by their probation")
    for key in ("safe_stops", "loader_dlopen_safe_stops"):
        if told[key] != 0:
            found.append(f"{key} is {told[key]}: swaps after a stop are no evidence, because the robot does not move")
    if told["lost_ticks_attributable_steal_aware"] != 0:
        found.append("ticks are lost more often while swapping")
    found += [later(told, us) for us, key in zip(LIMITS_US, LATER, strict=True) if not told[f"{key}_low"] <= MOST_LATER]
    if stepped(told) and not at_rest_too(told):
        found.append(
            f"while swapping the torque stepped by {told['max_output_step_nm']:.4f} N m in one tick, "
            f"and the guard of robots/arm.toml would limit it to {told['slew_bound_nm']:.4f}"
        )
    if not (told["continuity_step_ratio"] or 0) >= continuity.LEAST_RATIO:
        found.append(f"the torque step of a cold swap is less than {continuity.LEAST_RATIO:.0f} times that of LITHE")
    return found
