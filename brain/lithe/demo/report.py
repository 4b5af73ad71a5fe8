# SPDX-License-Identifier: Apache-2.0
"""Prints the summary for people."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def _verdict(summary: dict[str, Any]) -> None:
    """What was missed, what of it the machine has to answer for, what came out and why."""
    timing = summary["timing"]
    for name, words in (("run", "in the run"), ("swaps", "between request and commit")):
        if told := timing.get(name):
            print(
                f"  missed      {told['missed']} of {told['releases']} releases {words} ({told['share']:.2%}); "
                f"the machine's: {told['machine']}, our own: {told['own']}"
            )
    print(
        f"  machine     took the core for {timing['stolen_ms']:.0f} ms (hypervisor) and {timing['waited_ms']:.1f} ms "
        f"(other programs, {timing['involuntary_switches']} switches)"
    )
    machine = summary["machine"]
    print(
        f"  on          {machine['cpu']}, {machine['cores']} cores, Linux {machine['kernel']}, {machine['privileges']}"
    )
    if machine["lost"]:
        print(f"  this machine cannot give: {machine['lost']}")
    for sentence in summary["falls_short"]:
        print(f"  FALLS SHORT: {sentence}")
    for sentence in summary["inconclusive"]:
        print(f"  INCONCLUSIVE: {sentence}")
    word = {"holds": "the claim holds", "falls_short": "the claim falls short"}.get(summary["verdict"])
    print(f"  verdict     {word or 'INCONCLUSIVE: free the machine, or give the Spine a core (docs/rt.md); run again'}")


def report_stop(summary: dict[str, Any], out: Path) -> None:
    """Of a run that ended early, because the robot stopped itself."""
    print()
    _verdict(summary)
    print(f"  the programs' own words: {out}/log.txt")


def stages(swaps: list[dict[str, Any]]) -> None:
    """From request to commit: what each stage of each swap took, as their certificates say."""
    names = list(dict.fromkeys(stage for swap in swaps for stage in swap["split_ms"]))
    print(f"  {'stages [ms]':<24}" + "".join(f"{name:>10}" for name in names) + f"{'in all':>10}")
    for swap in swaps:
        cells = "".join(f"{swap['split_ms'].get(name, 0.0):>10.1f}" for name in names)
        print(f"  {'':<12}{swap['law']:<12}{cells}{swap['requested_to_committed_ms']:>10.1f}")


def estimates(joints: list[dict[str, Any]]) -> None:
    """What the agent found; of several joints a row for each, with what came of it."""
    if len(joints) == 1:
        joint = joints[0]
        least_nm, most_nm = joint["mgl_interval_nm"]
        covered = "inside" if joint["mgl_off_intervals"] <= 1 else "outside"
        print(f"  mgl         {joint['mgl_hat_nm']:.4f} N m estimated, 95 % interval {least_nm:.4f} to {most_nm:.4f}")
        print(
            f"  {'':<11} {joint['mgl_true_nm']:.4f} N m true, in units of the torque that the drive reports: "
            f"{covered} the interval, error of the estimate {joint['mgl_error']:.1%}"
        )
        return
    shown = ("baseline", "gravity_only", "evolved", "resumed", "reattached")
    print(
        f"  {'mgl [N m]':<12}{'found':>9}{'95 % interval':>18}{'true':>9}{'off by':>8}"
        + "".join(f"{name:>14}" for name in shown)
    )
    for joint in joints:
        found = f"{joint['mgl_hat_nm']:>9.4f}" if joint["mgl_hat_nm"] != 0 else f"{'none':>9}"
        least_nm, most_nm = joint["mgl_interval_nm"]
        interval = f"{f'{least_nm:.4f} - {most_nm:.4f}':>18}" if joint["mgl_hat_nm"] != 0 else f"{'':>18}"
        rmse = "".join(f"{joint['rmse_deg'].get(name, float('nan')):>10.2f} deg" for name in shown)
        print(f"  {joint['name']:<12}{found}{interval}{joint['mgl_true_nm']:>9.4f}{joint['mgl_error']:>8.1%}{rmse}")


def report(summary: dict[str, Any], out: Path) -> None:
    print()
    for phase in summary["phases"]:
        print(f"  {phase['name']:<12} RMSE {phase['rmse_deg']:7.2f} deg   ({phase['seconds']:.1f} s)")
    estimates(summary["joints"])
    for swap in summary["swaps"]:
        made = "taken from the cache" if swap["cached"] else f"compiled in {swap['compile_ms']:4.0f} ms"
        print(
            f"  swap        {swap['law']:<12} {made}, tick {swap['commit_tick']}, "
            f"torque step {swap['output_step_nm']:.4f} N m, "
            f"lost ticks {swap['lost_ticks_prepare']} preparing, {swap['lost_ticks_commit']} around the commit"
        )
    stages(summary["swaps"])
    for name, key in (
        ("swaps", "swap_windows"), ("commits", "commit_windows"), ("elsewhere", "no_swap_windows")
    ):  # fmt: skip
        tally = summary[key]
        print(
            f"  {name:<11} {tally['lost_per_s']:.2f} missed releases a second: "
            f"{tally['lost_ticks']} in {tally['seconds']:.1f} s, "
            f"in {tally['windows_with_loss']} of {tally['windows']} windows"
        )
    freeze = summary["freeze"]
    print(
        f"  freeze      {freeze['duration_s']:.2f} s, at rest at {freeze['rest_angle_deg']:.0f} deg; "
        f"largest excursion {freeze['max_excursion_deg']:.2f} deg"
    )
    for name, key in (("hand-off", "handoff_us"), ("jitter", "release_jitter_us")):
        q = summary[key]
        print(f"  {name:<11} p50 {q['p50']:.2f}  p99 {q['p99']:.2f}  p99.9 {q['p999']:.2f}  max {q['max']:.2f} us")
    print(
        f"  ticks       {summary['ticks']}, lost {summary['lost_ticks']}, "
        f"ticks after a deadline miss {summary['missed_deadlines']}"
    )
    print(f"  figures and telemetry in {out}/")
    _verdict(summary)
