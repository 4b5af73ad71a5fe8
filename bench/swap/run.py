# SPDX-License-Identifier: Apache-2.0
"""The cost of a swap: thousands of them in one run at 1 kHz, compared with the same laws replaced in the usual ways.

`python -m bench.swap [--swaps N]` -> out/bench/swap.json and a table. A round is a group of swaps of LITHE,
trials of a law that is refused (the work of a swap on the other cores, without a swap), and a pause; then each peer has
its round. The ticks lost while swapping are compared with those lost in the pauses of the same run, in windows of equal
length; late ticks with those beside the trials. Compilers run on the housekeeping core all the time. Exit 0: measured,
and the claims hold. 1: INCONCLUSIVE, undecided, or a claim does not hold. 2: usage.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import time
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from lithe.certificates import verify
from lithe.demo.losses import Window
from lithe.programs import ROOT

from bench import report
from bench.swap import continuity, table
from bench.swap.host import compiling, stolen_share, stolen_spans, watch_steal
from bench.swap.peers import Peers, Way, shaped
from bench.swap.robot import WIDE_NM_S, Subject, running, shipped_slew_bound_nm
from bench.swap.stats import Sides, largest_step_nm, on_the_move, stops_in
from bench.swap.verdict import CLAIMS, PEERS, reasons_to_doubt, shortcomings, undecided
from bench.tables import Figures

LAWS = [ROOT / "bench/swap/laws/pi_lowpass.cpp", ROOT / "bench/swap/laws/pi_two_pole.cpp", ROOT / "laws/pd.cpp"]
MOST_IN_GROUP, LEAST_IN_GROUP = 50, 8
PAUSE_S, LEAST_PAUSE_S = 0.4, 0.15
PEERS_PAUSE = 0.6  # of LITHE's: their groups are shorter too
LEAST_DLOPEN = 100
CONTROL_SWAPS = 10  # one in each round
CONTROL_TICKS = 200
CONTROL_S = 60.0
VARIANTS = 4  # of each law: for one that is still resident, dlopen would only increase its use count
# Expected: 0.1 s per swap. LITHE needs 30 ms with the trial, 15 ms for trials without a swap, then 10 ms of pause, and
# each of three peers 12 ms. If the trial has to wait for the compilers, 0.2 s.
MOST_S, MOST_PER_SWAP_S = 120.0, 0.4
# Verdicts of a swap that was committed.
FOUND = ("committed", "unproven", "confirmed", "rolled_back")


def stages_ms(records: list[dict[str, Any]]) -> Figures:
    """Time from request to commit, by stage: p50 and p99."""
    spent: dict[str, list[float]] = {}
    for record in records:
        steps = sorted(record["times_ns"].items(), key=lambda step: step[1])
        steps = [step for step in steps if step[1] <= record["times_ns"]["committed"]]
        for (_, since), (name, until) in pairwise(steps):
            spent.setdefault(f"stage_{name}", []).append((until - since) * 1e-6)
        spent.setdefault("requested_to_committed", []).append((steps[-1][1] - record["asked_ns"]) * 1e-6)
    told: Figures = {}
    for name, values in spent.items():
        p50, p99 = np.percentile(values, [50, 99])
        told |= {f"{name}_p50_ms": float(p50), f"{name}_p99_ms": float(p99)}
    return told


def certificates(folder: Path, records: list[dict[str, Any]]) -> Figures:
    """Counts the swaps whose certificate agrees with the answer, and is unchanged according to the chain."""
    found, undone = {}, set()
    paths = sorted(folder.glob("*.json"))
    broken = verify(folder).broken if paths else frozenset()
    for path in (each for each in paths if each.name not in broken):
        certificate = json.loads(path.read_text(encoding="utf-8"))
        if certificate.get("verdict") in FOUND:
            found[certificate["request_id"]] = certificate["commit_tick"]
        if certificate.get("verdict") == "rolled_back":
            undone.add(certificate["request_id"])
    return {
        "certificates": sum(found.get(record["request_id"]) == record["commit_tick"] for record in records),
        "swaps_rolled_back": sum(record["request_id"] in undone for record in records),
    }


def both_sides(sides: Sides, calm: Sides, ticks: Any) -> Figures:
    """Lost ticks, release jitter and delay of the output; steal-aware and raw."""
    told = sides.lost()
    told |= {f"{key}_steal_aware": value for key, value in calm.lost().items() if key.startswith("lost")}
    due_ns, output_ns = np.sort(ticks["release_ns"]), ticks["output_late_ns"]
    for each, suffix in ((calm, ""), (sides, "_raw")):
        figures = each.late_us(each.made.late_ns, each.made.due_ns, "jitter")
        figures |= each.late_us(output_ns, due_ns, "output")
        figures |= each.shares(each.made.late_ns, each.made.due_ns, "jitter")
        figures |= each.shares(output_ns, due_ns, "output")
        told |= {key + suffix: value for key, value in figures.items()}
    return told


def counted(ends: Counter[str]) -> str:
    """How often each code came."""
    return " ".join(f"{code}:{count}" for code, count in sorted(ends.items()))


def lithe_figures(subject: Subject, stolen: list[Window]) -> Figures:
    """All figures of LITHE."""
    ticks, made = subject.log.ticks(), subject.releases()
    rounds = on_the_move(subject.rounds, ticks)
    calm = Sides(rounds, made, stolen)
    told = both_sides(Sides(rounds, made), calm, ticks)
    trials = Sides([each.beside_trials() for each in rounds], made, stolen)
    told |= {f"trial_{key}": value for key, value in trials.shares(made.late_ns, made.due_ns, "jitter").items()}
    told |= {f"trial_{key}": value for key, value in trials.lost().items()}
    seconds = sum(b - a for each in subject.rounds for a, b in [each.swapping]) * 1e-9
    return told | {
        "swaps": len(subject.records),
        "swaps_asked": len(subject.records) + sum(subject.refused.values()),
        "trials_without_a_swap": subject.trials,
        "trials_not_refused": counted(subject.trials_wrong),
        "swaps_refused": counted(subject.refused),
        "swaps_per_s": len(subject.records) / max(seconds, 1e-9),
        "ticks": len(ticks),
        "ticks_not_recorded": subject.log.lost,
        "safe_stops": stops_in(ticks),
        "rounds_with_a_stop": len(subject.rounds) - len(rounds),
        "loader": subject.loader,
        "max_output_step_nm": largest_step_nm(ticks, calm.swapping),
        "max_output_step_at_rest_nm": largest_step_nm(ticks, np.concatenate([calm.resting, trials.resting])),
        "slew_bound_nm": shipped_slew_bound_nm(),
        **stages_ms(subject.records),
    }


def peer_figures(name: str, way: Way, stolen: list[Window]) -> Figures:
    """The same for one peer."""
    ticks, made = np.concatenate([shaped(part) for part in way.ticks]), way.releases()
    told = both_sides(Sides(way.rounds, made), Sides(way.rounds, made, stolen), ticks)
    p50, p999 = np.percentile(way.swap_ns, [50, 99.9])
    told |= {
        "swaps": len(way.swap_ns),
        "lost_ticks": told["lost_ticks_in"],
        "swap_p50_us": p50 / 1e3,
        "swap_p999_us": p999 / 1e3,
        "max_output_step_nm": max(largest_step_nm(shaped(part)) for part in way.ticks),
    }
    return {f"peer_{name}_{key}": value for key, value in told.items()}


def turns(swaps: int) -> tuple[int, float]:
    """Swaps in a group and the pause after it: at least twenty rounds, because rounds are compared."""
    group = min(MOST_IN_GROUP, max(LEAST_IN_GROUP, swaps // 20))
    return group, max(LEAST_PAUSE_S, PAUSE_S * group / MOST_IN_GROUP)


def most_s(swaps: int) -> float:
    """Time limit of a run of so many swaps."""
    return MOST_S + MOST_PER_SWAP_S * swaps


def take_turns(subject: Subject, peers: Peers, swaps: int) -> None:
    """Group by group, until LITHE and every peer did `swaps` swaps, or the time limit."""
    began = time.monotonic()
    until = began + most_s(swaps)
    most, pause_s = turns(swaps)
    left = dict.fromkeys(("", *PEERS), swaps)
    while any(left.values()) and time.monotonic() < until:
        for name in left:
            group = min(most, left[name])
            if group == 0:
                continue
            if name:
                left[name] -= peers.run(name, group, int(PEERS_PAUSE * pause_s * 1000))
            else:
                subject.group(group, pause_s)
                left[name] -= group
                subject.note_memory("middle" if left[name] >= swaps // 2 else "end")
        print(f"\rbench: swap {swaps - left['']} of {swaps}", end="", file=sys.stderr, flush=True)
    took_s = time.monotonic() - began
    print(f" requested in {took_s:.0f} s; not done, peers included: {sum(left.values())}", file=sys.stderr)


def main_run(folder: Path, swaps: int, load: list[list[str]]) -> Figures:
    """The arena and the peers, in turns; then the control."""
    with running(folder, torque_slew_nm_s=WIDE_NM_S) as robot:  # otherwise the guard would limit the measured steps
        info = robot.spine.info
        housekeeping = int(info["cpu_housekeeping"])
        steal, peers_steal = (watch_steal(int(info[f"cpu_{role}"])) for role in ("spine", "brain"))
        subject = Subject(robot, LAWS, (steal.look, peers_steal.look))
        try:
            with (
                Peers(int(info["cpu_brain"]), housekeeping, LAWS, folder) as peers,
                compiling(housekeeping, load, most_s(swaps) + CONTROL_S),
            ):
                take_turns(subject, peers, swaps)
                for _ in range(CONTROL_SWAPS):
                    peers.run("compile", 1, CONTROL_TICKS, gap_ticks=CONTROL_TICKS)
        finally:
            subject.stop()
        seen = steal.evidence()
        told = lithe_figures(subject, stolen_spans(seen)) | subject.memory() | subject.per_swap()
        told |= certificates(folder / "arm/swaps", subject.records)
        for name, way in peers.ways.items():
            told |= peer_figures(name, way, stolen_spans(peers_steal.evidence()))
        told["stolen_share"] = stolen_share(seen)
        told["preempted_share"] = subject.preempted_share()
        told["peers_share_a_core"] = len({int(info[f"cpu_{role}"]) for role in ("brain", "housekeeping")}) == 1
        told["control_failed_as_it_must"] = told["peer_compile_lost_rate_difference_low_per_s"] > 0
        return told


def dlopen_run(folder: Path, swaps: int, load: list[list[str]]) -> Figures:
    """LITHE with the portable loader: its cost on the Spine's core."""
    folder.mkdir()
    with running(folder, loader='"dlopen"') as robot:
        subject = Subject(robot, LAWS, variants=VARIANTS)
        try:
            with compiling(int(robot.spine.info["cpu_housekeeping"]), load, most_s(swaps)):
                for _ in range(max(1, swaps // LEAST_IN_GROUP)):
                    subject.group(LEAST_IN_GROUP, LEAST_PAUSE_S)
        finally:
            subject.stop()
        told = {
            "swaps": len(subject.records),
            "loader": subject.loader,
            "safe_stops": stops_in(subject.log.ticks()),
            **Sides(subject.rounds, subject.releases()).lost(),
            **subject.per_swap(),
        }
        return {f"loader_dlopen_{key}": value for key, value in told.items()}


def measure(swaps: int, out: Path) -> Figures:
    """One complete run; its log and certificates stay in `out`."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    began, load = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()), os.getloadavg()[0]
    contract = ROOT / "spine/law/include"
    compilers = [["g++", "-std=c++20", "-O2", f"-I{contract}", "-c", str(law), "-o", "/dev/null"] for law in LAWS]
    told = main_run(out, swaps, compilers)
    told |= dlopen_run(out / "dlopen", max(LEAST_DLOPEN, swaps // 20), compilers)
    told["swaps_wanted"] = swaps
    told |= continuity.measure(out, max(2, min(continuity.REPEATS, swaps // 100)))
    doubts, short = reasons_to_doubt(told), shortcomings(told)
    open_claims = [] if short else undecided(told)
    if doubts:
        told |= dict.fromkeys(CLAIMS)
    verdict = "falls short" if short else "undecided" if open_claims else "measured"
    return told | {
        "swap_verdict": "INCONCLUSIVE" if doubts else verdict,
        "swap_reason": "; ".join(doubts + short + open_claims),
        "swap_measured_at": began,
        "swap_load_before": load,
        "swap_load_after": os.getloadavg()[0],
    }


def plain(value: Any) -> Any:
    """A value for JSON: infinity and NaN become null."""
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def main(words: list[str]) -> int:
    """Measure, write, print."""
    parser = argparse.ArgumentParser(prog="python -m bench.swap", description=__doc__)
    parser.add_argument("--swaps", type=int, default=10_000, help="number for LITHE and for each peer (default 10000)")
    parser.add_argument("--out", type=Path, default=report.OUT, help="folder for swap.json (default out/bench)")
    asked = parser.parse_args(words)
    if asked.swaps < 1:
        parser.error("--swaps is at least 1")
    told = report.machine() | {key: plain(value) for key, value in measure(asked.swaps, asked.out / "swap").items()}
    runs = report.keep(asked.out / "swap.runs.jsonl", told)
    told["swap_runs"] = len(runs)
    path = asked.out / "swap.json"
    path.write_text(json.dumps(told, indent=2) + "\n")
    table.show(told)
    continuity.show(told)
    table.show_verdict(told)
    table.show_runs(runs)
    print(f"\nall figures: {path}")
    return 0 if told["swap_verdict"] == "measured" else 1
