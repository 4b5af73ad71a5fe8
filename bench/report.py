# SPDX-License-Identifier: Apache-2.0
"""Runs the bench programs, merges what they measured into out/bench/summary.json, and prints it as tables."""

import json
import os
import platform
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
OUT = ROOT / "out/bench"
TRIES = 3
MOST_DISTURBED = 0.05  # above this share of stolen or preempted cycles of the floor a run proves nothing
Figures = dict[str, Any]


def first_line(path: str, key: str = "") -> str:
    """The first line of a file that contains the key, or an empty string."""
    try:
        lines = Path(path).read_text(errors="replace").splitlines()
    except OSError:
        return ""
    return next((line for line in lines if key in line), "").partition(":")[2].strip() if key else lines[0].strip()


def machine() -> Figures:
    """What the figures were measured on: without it they mean nothing."""
    virtual = "hypervisor" in first_line("/proc/cpuinfo", "flags")
    return {
        "machine_cpu": first_line("/proc/cpuinfo", "model name") or platform.machine(),
        "machine_cores": os.cpu_count(),
        "machine_kernel": platform.release(),
        "machine_virtual": virtual,
        "machine_isolated_cores": first_line("/sys/devices/system/cpu/isolated"),
        "machine_governor": first_line("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor") or "unknown",
        "machine_clock_source": first_line("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
        "machine_load_at_start": os.getloadavg()[0],
        "measured_as_root": os.geteuid() == 0,
        "measured_at": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }


def measure(program: str) -> Figures:
    """The figures one program prints, or the end of this one with its message."""
    print(f"bench: {program} ...", file=sys.stderr, flush=True)
    path = ROOT / "build/release/bin" / f"bench_{program}"
    # A session of its own, as the Spine has: its priority must count against all others.
    done = subprocess.run([path], stdout=subprocess.PIPE, text=True, check=False, start_new_session=True)
    if done.returncode != 0:
        sys.exit(f"bench: {program} ended with {done.returncode}; run {path} to see why")
    figures: Figures = json.loads(done.stdout.splitlines()[-1])
    return figures


def measure_jitter() -> Figures:
    """Release jitter, again when the core was not ours; INCONCLUSIVE when it never is, and never a pass."""
    for attempt in range(1, TRIES + 1):
        figures = measure("jitter")
        figures["jitter_attempts"] = attempt
        stolen, preempted = figures["jitter_stolen_share"], figures["floor_preempted_share"]
        if max(stolen, preempted) <= MOST_DISTURBED:
            figures["jitter_verdict"] = "measured"
            return figures
        print(f"bench: {stolen:.1%} of the cycles stolen, {preempted:.1%} of the floor's preempted", file=sys.stderr)
    figures["jitter_verdict"] = "INCONCLUSIVE"
    return figures


def table(title: str, head: list[str], rows: list[list[str]]) -> None:
    """Prints aligned columns, the first to the left and the others to the right."""
    widths = [max(len(row[column]) for row in [head, *rows]) for column in range(len(head))]
    print(f"\n{title}")
    for row in [head, *rows]:
        print(
            "  "
            + "  ".join(
                f"{cell:<{w}}" if i == 0 else f"{cell:>{w}}"
                for i, (cell, w) in enumerate(zip(row, widths, strict=True))
            )
        )


def quantile_row(name: str, figures: Figures, key: str, more: list[str]) -> list[str]:
    """One row of p50, p99, p99.9 and max in microseconds."""
    return [name, *(f"{figures[f'{key}_{q}_us']:.2f}" for q in ("p50", "p99", "p999", "max")), *more]


def print_channel(figures: Figures) -> None:
    """The Channel among its peers."""
    kinds = [
        ("raw cache line, 56 bytes (floor)", "cache_line"),
        ("raw atomic word", "one_word"),
        ("Channel, 56 bytes", "channel_56"),
        ("Channel, 256 bytes", "channel_256"),
        ("Unix datagram, 256 bytes", "unix_datagram"),
        ("ZeroMQ ipc PAIR, 256 bytes", "zeromq"),
    ]
    rows = [quantile_row(name, figures, key, [f"{figures[key + '_over_pingpong']:.2f}"]) for name, key in kinds]
    table(
        "one-way latency between two cores, both sides polling [us]",
        ["", "p50", "p99", "p99.9", "max", "x floor"],
        rows,
    )
    print(f"  control: both sides on one core: {figures['control_same_core_over_pingpong']:.0f} x floor, as it must")


def print_jitter(figures: Figures) -> None:
    """Release jitter beside its floor and cyclictest."""
    kinds = [
        ("bare spin, steal-aware (floor)", "floor"),
        ("LITHE, steal-aware", "lithe"),
        ("bare spin, raw", "floor_raw"),
        ("LITHE, raw", "lithe_raw"),
        ("cyclictest, raw", "cyclictest"),
        ("control: a competitor on the core", "control"),
        ("hand-off: woken to command out", "handoff"),
    ]
    rows = [quantile_row(name, figures, key, []) for name, key in kinds]
    table("release jitter at 1 kHz [us]", ["", "p50", "p99", "p99.9", "max"], rows)
    print(f"  p99.9 over floor: {figures['release_jitter_p999_over_floor']:.2f}", end="")
    print(
        f" (raw {figures['release_jitter_p999_over_floor_raw']:.2f}, control {figures['control_over_floor']:.0f});",
        end=" ",
    )
    print(f"over cyclictest, raw: {figures['release_jitter_p999_over_cyclictest']:.3f}")
    print(f"  {figures['jitter_cycles']:.0f} cycles, stolen {figures['jitter_stolen_share']:.2%}, ", end="")
    print(f"preempted {figures['jitter_preempted_share']:.2%}: {figures['jitter_verdict']}")


def print_cost(figures: Figures) -> None:
    """What a tick costs without its law."""
    rows = [quantile_row(f"{joints} joints", figures, f"tick_cost_{joints}j", []) for joints in (1, 8, 32)]
    table("the tick's own cost, without the law [us]", ["", "p50", "p99", "p99.9", "max"], rows)


def print_contain(figures: Figures) -> None:
    """What containment costs, and what it takes to come back."""
    ways = [
        ("plain", "plain"),
        ("contained", "contained"),
        ("contained, vault by keys", "contained_keys"),
        ("contained, 4 KiB copied", "contained_copies_4k"),
        ("contained, no system calls", "contained_gated"),
        ("control: signal mask saved", "control"),
    ]
    rows = [[name, f"{figures['contain_call_ns_' + key]:.1f}"] for name, key in ways]
    table("one call of a law that does next to nothing [ns]", ["", "p50"], rows)
    kinds = [
        ("SIGSEGV", "write_null"),
        ("SIGFPE", "divide_by_zero"),
        ("SIGILL", "execute_garbage"),
        ("SIGTRAP", "hit_breakpoint"),
        ("SIGABRT", "give_up"),
        ("stack overflow", "overflow_stack"),
        ("endless, past its deadline", "loop_past_deadline_polled"),
        ("the same, spinning watchdog", "loop_past_deadline_spun"),
    ]
    rows = [quantile_row(name, figures, f"contain_{key}", []) for name, key in kinds]
    table("a law's fault until its stand-in is done [us]", ["", "p50", "p99", "p99.9", "max"], rows)
    print(f"  the watchdog takes {figures['contain_watchdog_core_share']:.1%} of its core")


def main() -> int:
    """Measure everything, or the programs named on the command line."""
    wanted = sys.argv[1:] or ["channel", "jitter", "cost", "contain"]
    figures = machine()
    if "channel" in wanted:
        figures |= measure("channel")
        figures["channel_latency_over_pingpong"] = figures["channel_56_over_pingpong"]
    if "jitter" in wanted:
        figures |= measure_jitter()
    if "cost" in wanted:
        figures |= measure("cost")
    if "contain" in wanted:
        figures |= measure("contain")
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "summary.json").write_text(json.dumps(figures, indent=2) + "\n")

    kind = "virtual machine" if figures["machine_virtual"] else "bare metal"
    print(f"{figures['machine_cpu']}, {figures['machine_cores']} cores, {kind}, Linux {figures['machine_kernel']}")
    shows = {"channel": print_channel, "jitter": print_jitter, "cost": print_cost, "contain": print_contain}
    for name, show in shows.items():
        if name in wanted:
            show(figures)
    print(f"\nall figures: {(OUT / 'summary.json').relative_to(ROOT)}")
    blind = [key for key, value in figures.items() if key.endswith("failed_as_it_must") and not value]
    if blind:
        print(
            f"bench: a control that must fail did not ({', '.join(blind)}): these figures prove nothing",
            file=sys.stderr,
        )
    return 1 if blind else 0


if __name__ == "__main__":
    sys.exit(main())
