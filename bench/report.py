# SPDX-License-Identifier: Apache-2.0
"""Runs benches, merges their figures into out/bench/summary.json, and prints them.

`python -m bench.report [NAME ...]`. Exit 0: measured. 1: a requested figure is INCONCLUSIVE (null). 2: usage.
Figures of benches that did not run this time stay, if they are from this machine.
"""

import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from bench import tables
from bench.tables import Figures

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "out/bench"
DISTURBED = 0.05  # above this share of stolen or preempted ticks a run is INCONCLUSIVE
RESTING = 0.3  # of the exchanges: a joint that reverses is at rest for a moment
BESIDE = 2.0  # times slower: a Spine on another core has almost no effect on one thread on the Brain's core
UNSTEADY = 0.25  # a figure whose rounds differ by more is INCONCLUSIVE


class Unmeasured(Exception):
    """A program gave no figures; the text says why."""


@dataclass(frozen=True)
class Bench:
    """How something is measured and shown, its claims, and the conditions for them."""

    command: tuple[str, ...]  # prints one line of JSON
    show: Callable[[Figures], None]
    claims: tuple[str, ...]  # figures; null if INCONCLUSIVE
    most: dict[str, float] = field(default_factory=dict)  # a figure above this is a reason to measure again
    # A figure, and the spread of its rounds: null if that is above UNSTEADY.
    steady: dict[str, str] = field(default_factory=dict)


def program(name: str) -> tuple[str, ...]:
    """The path of one of our C++ bench programs."""
    return (str(Path(os.environ.get("LITHE_BIN_DIR") or ROOT / "build/release/bin") / f"bench_{name}"),)


PARTS = ("encode", "parse")
CODEC_SPREADS = {f"codec_lithe_{part}_ns": f"codec_python_{part}_spread" for part in PARTS} | {
    f"codec_{peer}_over_lithe_{part}": f"codec_{peer}_{part}_spread"
    for peer in ("python", "upstream")
    for part in PARTS
}
COST_SHARES = [f"tick_cost_{kind}_share_{joints}j" for kind in ("stolen", "preempted") for joints in (1, 8, 32)]
BENCHES = {
    "channel": Bench(
        program("channel"),
        tables.show_channel,
        ("channel_latency_over_pingpong", "channel_56_over_one_word", "channel_plan_over_raw"),
        {"channel_round_spread": UNSTEADY},
    ),
    "jitter": Bench(
        program("jitter"),
        tables.show_jitter,
        (
            "release_jitter_p999_over_floor",
            "release_jitter_p99_over_floor",
            "release_jitter_p999_over_cyclictest",
            "release_jitter_p50_over_cyclictest",
            "handoff_p50_us",
            "handoff_p999_us",
        ),
        {"jitter_stolen_share": DISTURBED, "floor_preempted_share": DISTURBED},
    ),
    "cost": Bench(
        (*program("scale"), "cost"),
        tables.show_cost,
        ("tick_cost_p50_us_1j", "tick_cost_p50_us_8j", "tick_cost_p50_us_32j"),
        dict.fromkeys(COST_SHARES, DISTURBED),
    ),
    "contain": Bench(
        program("contain"),
        tables.show_contain,
        ("contain_call_ns_plain", "contain_call_ns_contained", "contain_write_null_p50_us"),
    ),
    "scale": Bench(
        (sys.executable, "-m", "bench.scale", "--figures"),
        tables.show_scale,
        (
            *(f"exchange_{joints}j_{figure}" for joints in (1, 4, 12, 32) for figure in ("p50_us", "over_empty")),
            *(f"scale_{part}_{joints}j_p50_us" for part in ("tick", "transport") for joints in (1, 4, 12, 32)),
            *(f"codec_lithe_{part}_ns" for part in PARTS),
            *(f"codec_python_over_lithe_{part}" for part in PARTS),
        ),
        dict.fromkeys(("scale_away_share", "scale_stolen_share", "scale_preempted_share"), DISTURBED)
        | {"scale_unanswered_share": 0.0, "scale_resting_share": RESTING},
        steady=CODEC_SPREADS,
    ),
    "host": Bench(
        (sys.executable, "-m", "bench.host", "--figures"),
        tables.show_host,
        (
            "host_touch_first_p50_us",
            "host_touch_first_p999_us",
            "host_grid_whole_late_share",
            "host_grid_moved_late_share",
            "host_nice_ordinary_skipped_share",
            "host_brain_own_slower",
        ),
        dict.fromkeys(("host_stolen_share", "host_preempted_share", "host_grid_control_difference"), DISTURBED)
        | {"host_brain_one_slower": BESIDE},
    ),
    "release": Bench(
        program("release"),
        tables.show_release,
        tuple(
            f"release_{way}_{figure}"
            for way in ("spin", "hybrid", "sleep")
            for figure in ("p50_us", "p99_us", "over_20us", "over_100us", "processor_share")
        ),
    ),
    "run": Bench(
        (sys.executable, "-m", "bench.live"),
        tables.show_run,
        ("run_release_jitter_p50_us", "run_release_jitter_p99_us", "run_release_jitter_p999_us", "run_handoff_p50_us"),
        {"run_stolen_share": DISTURBED, "run_preempted_share": DISTURBED, "run_inactive_share": 0.0},
    ),
}


def first_line(path: str, key: str = "") -> str:
    """The first line of a file that contains the key, or an empty string."""
    try:
        lines = Path(path).read_text(errors="replace").splitlines()
    except OSError:
        return ""
    return next((line for line in lines if key in line), "").partition(":")[2].strip() if key else lines[0].strip()


def machine() -> Figures:
    """A description of the machine; figures are meaningless without it."""
    return {
        "machine_cpu": first_line("/proc/cpuinfo", "model name") or platform.machine(),
        "machine_cores": os.cpu_count(),
        "machine_kernel": platform.release(),
        "machine_virtual": "hypervisor" in first_line("/proc/cpuinfo", "flags"),
        "machine_isolated_cores": first_line("/sys/devices/system/cpu/isolated"),
        "machine_governor": first_line("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor") or "unknown",
        "machine_clock_source": first_line("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
        "measured_as_root": os.geteuid() == 0,
        **cores(),
    }


def cores() -> Figures:
    """The cores that bench/rig/machine.cpp selects, and whether they are isolated; empty if there are none."""
    try:
        done = subprocess.run(program("cores"), capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):  # not built, or fewer than two cores
        return {}
    told: Figures = json.loads(done.stdout)
    return told


def measure(command: tuple[str, ...]) -> Figures:
    """The figures that a program prints."""
    try:
        # A separate session, as the Spine has: its nice value must count against all other threads.
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False, start_new_session=True, cwd=ROOT)
    except OSError as error:
        raise Unmeasured(f"{command[0]}: {error.strerror}; `make bench` builds it") from None
    if done.returncode != 0:
        raise Unmeasured(f"{' '.join(command)} ended with {done.returncode}")
    figures: Figures = json.loads(done.stdout.splitlines()[-1])
    return figures


def disturbances(bench: Bench, figures: Figures) -> list[str]:
    """The reasons why this run is INCONCLUSIVE."""
    found = []
    for key, most in bench.most.items():
        value = figures.get(key)
        if value is None or value > most:
            found.append(f"{key} is {tables.cell(figures, key, '.1%')}, above {most:.0%}")
    blind = [key for key, value in figures.items() if key.endswith("failed_as_it_must") and not value]
    return found + [f"the negative control did not fail ({key})" for key in blind]


def unsteady(bench: Bench, figures: Figures) -> dict[str, str]:
    """Figures that are INCONCLUSIVE because their rounds differ too much; and the reason of each."""
    found = {}
    for figure, key in bench.steady.items():
        value = figures.get(key)
        if figures.get(figure) is not None and (value is None or not value <= UNSTEADY):
            found[figure] = f"{key} is {tables.cell(figures, key, '.1%')}, above {UNSTEADY:.0%}: no {figure}"
    return found


def examine(name: str, bench: Bench) -> Figures:
    """Measures once. A run that the machine disturbed is INCONCLUSIVE, and its claims are null."""
    load, began = os.getloadavg()[0], time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    print(f"bench: {name} ...", file=sys.stderr, flush=True)
    reasons, doubts = [], dict[str, str]()
    try:
        figures = measure(bench.command)
        reasons, doubts = disturbances(bench, figures), unsteady(bench, figures)
    except Unmeasured as error:
        figures, reasons = {}, [str(error)]
    for reason in (*reasons, *doubts.values()):
        print(f"bench: {name}: {reason}", file=sys.stderr)
    if reasons:
        figures |= dict.fromkeys(bench.claims)
    else:
        reasons = [f"{claim} has no value" for claim in bench.claims if figures.get(claim) is None]
        figures |= dict.fromkeys(claim for claim in bench.claims if figures.get(claim) is None)
    figures |= dict.fromkeys(doubts)
    reasons += doubts.values()
    return figures | {
        f"{name}_verdict": "INCONCLUSIVE" if reasons else "measured",
        f"{name}_reason": "; ".join(reasons),
        f"{name}_measured_at": began,
        f"{name}_load_before": load,
        f"{name}_load_after": os.getloadavg()[0],
    }


def code() -> str:
    """The commit that is measured; with "+" when files were changed since."""
    words = ["git", "describe", "--always", "--dirty=+", "--exclude=*"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=ROOT)
    return done.stdout.strip() or "unknown"


def keep(path: Path, figures: Figures) -> list[Figures]:
    """Appends a run to all that were measured here, whatever its verdict, so that none can be left out; all of them."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(figures | {"code": code()}) + "\n")
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def earlier(name: str, here: Figures) -> Figures:
    """The earlier figures of a bench that does not run now, if they are from this machine."""
    try:
        old: Figures = json.loads((OUT / f"{name}.json").read_text())
    except (OSError, ValueError):
        return {}
    passing = "machine_spine_core_interrupts"  # the kernel and irqbalance may change them at any time
    return old if all(old.get(key) == value for key, value in here.items() if key != passing) else {}


def main(words: list[str]) -> int:
    """Measure everything, or the benches named."""
    if unknown := [word for word in words if word not in BENCHES]:
        print(f"bench: no bench '{unknown[0]}'; there are {', '.join(BENCHES)}", file=sys.stderr)
        return 2
    wanted = words or list(BENCHES)
    OUT.mkdir(parents=True, exist_ok=True)
    figures = here = machine()
    for name, bench in BENCHES.items():
        if name in wanted:
            own = examine(name, bench)
            own[f"{name}_runs"] = len(keep(OUT / f"{name}.runs.jsonl", here | own))
            (OUT / f"{name}.json").write_text(json.dumps(here | own, indent=2) + "\n")
            figures = figures | own
        else:
            figures = figures | earlier(name, here)
    path = OUT / "summary.json"
    path.write_text(json.dumps(figures, indent=2) + "\n")

    tables.show_machine(figures)
    for name in wanted:
        BENCHES[name].show(figures)
        why = f" ({figures[f'{name}_reason']})" if figures[f"{name}_reason"] else ""
        print(
            f"  {name}: {figures[f'{name}_verdict']}{why}; load {figures[f'{name}_load_before']:.1f} before, ", end=""
        )
        print(f"{figures[f'{name}_load_after']:.1f} after; run {figures[f'{name}_runs']} of those in {name}.runs.jsonl")
    print(f"\nall figures: {path}")
    return 1 if any(figures[f"{name}_verdict"] != "measured" for name in wanted) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
