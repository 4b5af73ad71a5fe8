# SPDX-License-Identifier: Apache-2.0
"""Whether the claim holds in a run: `holds`, `falls_short`, or `INCONCLUSIVE`, and why.

A run is INCONCLUSIVE when too many releases were missed to say that the claim holds, and the kernel's own counts say
that the machine took the Spine's core away for at least half of them; or when too many were missed between request and
commit, and as many elsewhere in the run. A missed release that no evidence explains is the Spine's own. A NaN never
holds.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from . import losses
from .evidence import Evidence, tally
from .joints import shortcomings
from .judge import PHASES, span_of

LEAST_FREEZE_S = 1.5
LEAST_SWAPS = 4  # as in the paper
LEAST_SILENT_S = 1.4  # as the Spine saw it; the last sign of life came just before the freeze
# Of the releases, how many may be missed: of the run's, and of those from the requests of its swaps to their commits,
# which take two seconds, so that three of them may always be.
MOST_MISSED, MOST_MISSED_IN_SWAPS, THREE = 0.001, 0.002, 3
MOST_DISTURBED = 0.01  # of the releases, taken by the machine: beyond, nobody can tell how well a law tracks
# How likely swaps must be to have lost so many ticks by accident. Of five commits three must have had a loss where
# there is hardly any elsewhere; one stall, or two, that fall into their windows are no proof.
LEAST_CHANCE = 0.001
STOP_S = 1.0  # before a stop, in which its cause is looked for
WORDS = {"holds": 0, "falls_short": 1, "INCONCLUSIVE": 4}  # and the exit code of each


@dataclass
class Verdict:
    """What falls short, and what cannot be decided in this run; one sentence each."""

    falls_short: list[str] = field(default_factory=list)
    inconclusive: list[str] = field(default_factory=list)

    @property
    def word(self) -> str:
        """One of WORDS."""
        if self.falls_short:
            return "falls_short"
        return "INCONCLUSIVE" if self.inconclusive else "holds"

    def told(self) -> dict[str, Any]:
        """For the summary."""
        return {"verdict": self.word, "falls_short": self.falls_short, "inconclusive": self.inconclusive}


def explained(tally: dict[str, Any]) -> bool:
    """The machine took the core for as long as half of the missed releases took, or longer."""
    return bool(tally["missed"] > 0 and tally["machine"] * 2 >= tally["missed"])


def _share(tally: dict[str, Any]) -> str:
    return (
        f"{tally['missed']} of {tally['releases']} releases were missed ({tally['share']:.2%}), "
        f"{tally['machine']} of these while the machine had taken the core"
    )


def _chance(summary: dict[str, Any], scope: str, key: str, when: str) -> str:
    here, there = summary[key], summary["no_swap_windows"]
    return (
        f"swaps lose ticks {when}: {here['lost_ticks']} missed in {here['windows_with_loss']} of {here['windows']} "
        "windows, "
        f"{there['lost_ticks']} in {there['windows_with_loss']} of {there['windows']} elsewhere "
        f"(by accident: {summary['timing'][scope]['chance']:.1g}); {_share(summary['timing'][scope])}"
    )


def timing(summary: dict[str, Any]) -> Verdict:
    """Of missed releases: in the whole run, and from the requests of swaps to their commits."""
    told, found = summary["timing"], Verdict()

    def judged(sentence: str, scope: str) -> None:
        (found.inconclusive if explained(told[scope]) else found.falls_short).append(sentence)

    if not told["run"]["share"] <= MOST_MISSED:
        judged(f"in the run {_share(told['run'])}; at most {MOST_MISSED:.1%} may be", "run")
    guilty = False
    for scope, key, when in (
        ("swaps", "swap_windows", "between request and commit"),
        ("commits", "commit_windows", "around a commit"),
    ):
        if not told[scope]["chance"] >= LEAST_CHANCE:
            guilty = True
            judged(_chance(summary, scope, key, when), scope)
    if not guilty and told["swaps"]["missed"] > max(THREE, MOST_MISSED_IN_SWAPS * told["swaps"]["releases"]):
        found.inconclusive.append(
            f"between request and commit {_share(told['swaps'])}; at most {MOST_MISSED_IN_SWAPS:.1%} may be, but "
            f"elsewhere in the run as much is lost (by accident: {told['swaps']['chance']:.1g})"
        )
    return found


def experiment(summary: dict[str, Any]) -> list[str]:
    """What falls short apart from timing, one sentence each."""
    seen = {phase["name"] for phase in summary["phases"]}
    wrong = [f"phase '{name}' is missing" for name in PHASES if name not in seen]
    joints = summary["joints"]
    for joint in joints:
        wrong += shortcomings(joint, of_several=len(joints) > 1)
    freeze = summary["freeze"]
    if not freeze["duration_s"] >= LEAST_FREEZE_S:
        wrong.append(f"the Brain was frozen for {freeze['duration_s']:.2f} s, less than {LEAST_FREEZE_S} s")
    if not freeze["brain_silent_s"] >= LEAST_SILENT_S:
        wrong.append(f"the frozen Brain was silent for {freeze['brain_silent_s']:.2f} s only")
    if not len(summary["swaps"]) >= LEAST_SWAPS:
        wrong.append(f"{len(summary['swaps'])} laws were swapped in, at least {LEAST_SWAPS} expected")
    for swap in summary["swaps"]:
        if not swap["output_step_nm"] <= swap["output_step_bound_nm"] + 1e-9:
            where = f" of joint '{joints[swap['output_step_joint']]['name']}'" if len(joints) > 1 else ""
            wrong.append(
                f"the swap to '{swap['law']}' stepped the torque{where} by {swap['output_step_nm']:.4f} N m, "
                f"the guard's bound is {swap['output_step_bound_nm']:.4f} N m"
            )
    if summary["records_lost"] != 0:
        wrong.append(f"{summary['records_lost']} telemetry records were overwritten before they were read")
    return wrong


def disturbed(summary: dict[str, Any]) -> bool:
    """The machine took so much of the run that tracking and estimates in it prove nothing."""
    run = summary["timing"]["run"]
    return bool(run["machine"] > MOST_DISTURBED * run["releases"])


def verdict(summary: dict[str, Any]) -> Verdict:
    """Of a run that came to its end."""
    found, wrong = timing(summary), experiment(summary)
    if wrong and disturbed(summary):
        took = summary["timing"]["run"]
        why = f"the machine took the core for {took['machine']} of {took['releases']} releases"
        found.inconclusive += [f"{sentence}; but {why}" for sentence in wrong]
    else:
        found.falls_short += wrong
    return found


def of_stop(records: npt.NDArray[Any], evidence: Evidence, fault: str, phase: str, period_ns: int) -> dict[str, Any]:
    """Of a run in which the robot stopped itself: whose fault that was, by what was missed in the second before."""
    stopped = np.flatnonzero(records["fault"] != 0)
    at_ns = int(records["release_ns"][stopped[0] if len(stopped) else -1]) + 1
    made = losses.with_missed_deadlines(losses.releases(records, period_ns), records)
    before = tally(made, [(at_ns - int(STOP_S * 1e9), at_ns)], evidence, period_ns)
    sentence = f"the robot stopped itself in phase '{phase}' ({fault}): in the second before, {_share(before)}"
    found = Verdict(inconclusive=[sentence]) if explained(before) else Verdict(falls_short=[sentence])
    whole = tally(made, losses.slices(span_of(records), 1_000_000_000), evidence, period_ns)
    timing = {"run": whole, "before_the_stop": before, **evidence.told()}
    return {"stopped": {"fault": fault, "phase": phase}, "timing": timing, **found.told()}
