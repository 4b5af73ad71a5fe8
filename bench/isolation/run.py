# SPDX-License-Identifier: Apache-2.0
"""Release jitter and hand-off of LITHE under load, beside the floor and what people use today: the paper's experiment.

`python -m bench.isolation [--seconds N | --short | --paper] [--workload NAME ...] [--shield]` writes
out/bench/isolation.json, .png and .html; those of the run before become *.previous. Under each workload the programs
take turns in rounds of a few seconds.
`compare A.json B.json` prints two results beside each other, `summary RESULT.json` what goes into bench/boards/,
`table DIR` a table of all results in a folder.
Exit 0: holds. 1: falls short, or INCONCLUSIVE. 2: usage, or it cannot be measured here.
"""

from __future__ import annotations

import argparse
import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lithe.demo.evidence import stolen_ticks
from lithe.demo.processes import undisturbed
from lithe.errors import LitheError
from lithe.programs import binary

from bench import report
from bench.isolation import loads, outsider, plot, table
from bench.isolation.attribution import Trace, accounting
from bench.isolation.figures import (
    CONTROL,
    FLOOR,
    LITHE,
    PEERS,
    WRITING,
    Rounds,
    calm,
    kernel_share,
    ratio,
    stolen,
    workload_figures,
)
from bench.isolation.programs import Peers, Subject
from bench.isolation.verdict import judge
from bench.swap.run import plain
from bench.tables import Figures

SECONDS = 60.0  # of LITHE in each workload
PAIRS = 5  # in a round: 500 ms of each floor and 500 ms of LITHE
CONTROL_BLOCKS = 6
RESULTS = ("isolation.json", "isolation.png", "isolation.html")
SHIELDED = "LITHE_BENCH_SHIELDED"
SHIELD_JOURNAL = Path("/run/lithe/shield.journal")  # as in host/tune/shield/shield.hpp
Seen = dict[str, dict[str, Rounds]]  # by workload and program


@dataclass(frozen=True)
class Plan:
    """What is measured: so many rounds of so many pairs and of so many seconds of each peer, under each workload."""

    workloads: list[str]
    rounds: int
    pairs: int
    peer_s: float

    def most_s(self) -> float:
        """No load runs longer than this."""
        return 120.0 + 3 * self.rounds * (1.5 * self.pairs + len(PEERS) * (self.peer_s + 1))


def plan_of(asked: argparse.Namespace) -> Plan:
    """The plan that the options ask for."""
    workloads = list(dict.fromkeys(asked.workload or loads.WORKLOADS))
    if asked.short:
        return Plan(workloads, rounds=1, pairs=2, peer_s=1.0)
    if asked.paper:  # 300 s of each: 300,000 cycles at 1 kHz
        return Plan(workloads, rounds=100, pairs=6, peer_s=3.0)
    return Plan(workloads, rounds=max(1, round(asked.seconds / (PAIRS * 0.5))), pairs=PAIRS, peer_s=1.0)


def shield_is_up() -> bool:
    """Whether a living process holds the lock on the shield's journal, as it does until the shield is lowered."""
    try:
        with SHIELD_JOURNAL.open("rb") as journal:
            fcntl.flock(journal, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        pass
    return False


def free_cores(all_cores: list[int], spine: int, partner: int) -> list[int]:
    """Those that a shield leaves to others, the Brain's last. From three cores on, the partner's is the Transport's."""
    return [core for core in all_cores if core != spine and (core != partner or len(all_cores) < 3)]


def one_round(subject: Subject, peers: Peers, plan: Plan, seen: dict[str, Rounds]) -> None:
    """The floors and LITHE in turns, then each peer."""
    records = subject.run("pairs", plan.pairs, 1.5 * plan.pairs)
    for program, number in (("floor", FLOOR), ("writing", WRITING), ("lithe", LITHE)):
        seen.setdefault(program, []).append(records[records["program"] == number])
    for peer in PEERS:
        block = peers.records(peer, plan.peer_s)
        if block is not None:
            seen.setdefault(peer, []).append(block)


class Bench:
    """The programs, the cores, and everything seen so far."""

    def __init__(self, plan: Plan, folder: Path) -> None:
        here = report.cores()
        if not here:
            raise report.Unmeasured("needs bench_cores (`make bench-isolation` builds it) and two cores")
        self.plan, self.folder = plan, folder
        self.spine, self.partner = int(here["machine_spine_core"]), int(here["machine_partner_core"])
        self.all = sorted(os.sched_getaffinity(0) | {self.spine, self.partner})
        free = free_cores(self.all, self.spine, self.partner)
        self.brain = free[-1]
        self.confined = bool(os.environ.get(SHIELDED)) and shield_is_up()
        if os.environ.get(SHIELDED) and not self.confined:
            print(f"bench: {SHIELDED} is set, but no shield is up: measured without one", file=sys.stderr)
        self.load_cores = ",".join(map(str, free if self.confined else self.all))
        os.sched_setaffinity(0, set(free) & os.sched_getaffinity(0) or set(free))  # this process measures nothing
        self.seen: Seen = {}
        self.told: Figures = {"shielded": self.confined, "loads_cores": self.load_cores}

    def under(self, workload: str, subject: Subject, peers: Peers) -> None:
        """All rounds of one workload."""
        cores, folder = (self.load_cores, ",".join(map(str, self.all))), self.folder / "storm"
        load = loads.load_of(workload, *cores, self.brain, folder, self.plan.most_s())
        log = self.folder / "loads.log"
        self.told |= {f"load_{workload}": load.words, "loads_log": str(log)}
        pid = os.environ.get(outsider.PID) if workload == "numpy" else None
        rogue = outsider.running(int(pid) if pid else None, self.spine, self.told)
        with loads.running(load, log) as started, rogue:
            offers, swaps = subject.offers(workload == "swap"), loads.swaps_in(log)  # from here on they count
            ticks = stolen_ticks(self.spine)
            for number in range(self.plan.rounds):
                words = f"\rbench: {workload}, round {number + 1} of {self.plan.rounds} "
                print(words, end="", file=sys.stderr, flush=True)
                one_round(subject, peers, self.plan, self.seen.setdefault(workload, {}))
            self.told[f"steal_share_kernel_{workload}"] = kernel_share(ticks, stolen_ticks(self.spine))
            self.told[f"load_ended_{workload}"] = loads.ended_early(started)
            self.told[f"shield_lost_{workload}"] = self.confined and not shield_is_up()
            if workload == "swap":
                self.told["second_robot_swaps"] = loads.swaps_in(log) - swaps
                self.told["rig_offers"] = subject.offers(False) - offers
        print(file=sys.stderr)

    def run(self) -> None:
        """All workloads, then the control."""
        self.told |= accounting()
        trace = Trace(self.spine, apart=self.told["machine_irq_time_accounting"] is not False)
        with trace, Subject(",".join(map(str, self.all)), self.folder / "records", trace) as subject:
            self.told["attribution"] = trace.why_not or "the kernel's trace of switches and interrupts"
            peers = Peers(subject, self.all, self.spine, self.folder)
            try:
                for workload in self.plan.workloads:
                    self.under(workload, subject, peers)
            finally:
                with undisturbed():
                    peers.close()
            control = subject.run("control", CONTROL_BLOCKS, CONTROL_BLOCKS)
            self.told["untraced_blocks"] = trace.untraced
        self.told |= {f"{name}_absent": why for name, why in peers.absent.items()}
        last = self.seen[self.plan.workloads[-1]]  # idle, unless it was left out
        self.told["control_over_floor"] = ratio(calm([control[control["program"] == CONTROL]]), calm(last["floor"]))

    def figures(self) -> Figures:
        """All of them, and the verdict."""
        for workload, seen in self.seen.items():
            whole = {name: rounds for name, rounds in seen.items() if len(rounds) == self.plan.rounds}
            self.told |= workload_figures(workload, whole)
        both = [each for seen in self.seen.values() for name in ("floor", "lithe") for each in seen[name]]
        self.told["steal_share"] = float(np.mean(stolen(np.concatenate(both))))
        return self.told | judge(self.told, self.plan.workloads)


def doctor() -> str:
    """What `lithe doctor` says about this machine, as JSON text; or why it says nothing."""
    try:
        words = [str(binary("lithe")), "--json", "doctor"]
        done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=120)
        return json.dumps(json.loads(done.stdout), indent=1)
    except (LitheError, OSError, subprocess.TimeoutExpired) as why:
        return f"not asked: {why}"
    except ValueError:
        return f"`lithe --json doctor` gave no JSON (exit {done.returncode}): {done.stderr.strip()[:300]}"


def shielded(words: list[str]) -> list[str]:
    """The command that does the same under `lithe tune shield`; report.Unmeasured when there is no such verb."""
    try:
        lithe = str(binary("lithe"))
        known = subprocess.run([lithe, "tune", "shield", "--help"], capture_output=True, text=True, check=False)
    except (LitheError, OSError) as why:
        raise report.Unmeasured(str(why)) from None
    if known.returncode != 0 or "shield" not in known.stdout:
        raise report.Unmeasured(f"{lithe} has no `tune shield`: measure without --shield, or {loads.BY_HAND}")
    rest = [word for word in words if word != "--shield"]
    cores: list[str] = []  # the shield takes the robot's own choice
    if named := os.environ.get("LITHE_BENCH_CORES"):
        both = [int(core) for core in named.split(",") if core.isdecimal()]
        if len(set(both)) != 2:
            raise report.Unmeasured(f"LITHE_BENCH_CORES names two different cores, as in 1,3; it says '{named}'")
        free = free_cores(sorted(os.sched_getaffinity(0) | set(both)), *both)
        cores = ["--cores", ",".join(str(core) for core in sorted(both) if core not in free)]
    return [lithe, "tune", "shield", *cores, "--", sys.executable, "-m", "bench.isolation", *rest]


def measure(plan: Plan, out: Path) -> Figures:
    """One run; its files stay in `out`/isolation."""
    folder = out / "isolation"
    began, load = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()), os.getloadavg()[0]
    here = report.machine()
    bench = Bench(plan, folder)
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "buses").mkdir(parents=True)
    older = [out / name for name in RESULTS if (out / name).exists()]
    for path in older:  # an old result must not look like this run's, should it be stopped
        path.replace(f"{path}.previous")
    try:
        bench.run()
    except report.Unmeasured:
        for path in older:
            Path(f"{path}.previous").replace(path)
        raise
    finally:
        (folder / "records").unlink(missing_ok=True)
    told = here | {"isolation_measured_at": began, "isolation_load_before": load} | bench.figures()
    told = {key: plain(value) for key, value in told.items()}
    figures, image, page = (folder / name for name in RESULTS)
    told["isolation_runs"] = len(report.keep(out / "isolation.runs.jsonl", told))
    figures.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
    figures.replace(out / figures.name)  # before the drawing, which may fail after hours of measuring
    plot.draw(bench.seen, told, image)
    plot.page(told, table.text(told), doctor(), image, page)
    for path in (image, page):
        path.replace(out / path.name)
    return told


def options(words: list[str]) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.isolation", description=__doc__)
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--short", action="store_true", help="a few seconds of each; no verdict")
    length.add_argument("--paper", action="store_true", help="300,000 cycles of each, as in the paper")
    length.add_argument(
        "--seconds", type=float, default=SECONDS, help=f"of LITHE in each workload (default {SECONDS:.0f})"
    )
    parser.add_argument("--workload", action="append", choices=loads.WORKLOADS, help="only this one; may be repeated")
    parser.add_argument(
        "--shield", action="store_true", help="under `lithe tune shield`: needs root, undone at the end"
    )
    parser.add_argument("--out", type=Path, default=report.OUT, help="folder for the results (default out/bench)")
    asked = parser.parse_args(words)
    if not 1 <= asked.seconds <= 86_400:
        parser.error("--seconds is from 1 to 86400")
    return asked


def main(words: list[str]) -> int:
    """Measure, write, print; or one of the other verbs."""
    if words[:1] in (["compare"], ["summary"], ["table"]):
        return table.main(words)
    asked = options(words)
    for number in (signal.SIGINT, signal.SIGTERM):  # also where a shell let both be ignored: the loads must end
        signal.signal(number, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # ignored: under nohup
        signal.signal(signal.SIGHUP, signal.default_int_handler)
    try:
        plan = plan_of(asked)
        command = shielded(words) if asked.shield and not os.environ.get(SHIELDED) else []
        with outsider.beside("numpy" in plan.workloads):
            if command:
                os.execve(command[0], command, os.environ | {SHIELDED: "1"})
            told = measure(plan, asked.out)
    except report.Unmeasured as why:
        print(f"bench: {why}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nbench: stopped; the loads are ended; an older result is in isolation.json.previous", file=sys.stderr)
        return 130
    print(table.text(told))
    print(f"\nall figures: {asked.out / 'isolation.json'}; page: {asked.out / 'isolation.html'}")
    return 0 if told["verdict"] == "holds" else 1
