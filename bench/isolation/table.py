# SPDX-License-Identifier: Apache-2.0
"""Results of `make bench-isolation` as text: one, two beside each other, or all of a folder for docs/host.md."""

from __future__ import annotations

import contextlib
import io
import json
import sys
from pathlib import Path
from typing import Any

from bench.isolation.figures import CAUSES, PEERS
from bench.isolation.loads import WORKLOADS
from bench.isolation.plot import PAPER_HANDOFF_US, PAPER_JITTER_US, WORDS
from bench.swap.stats import LIMITS_US
from bench.tables import HEAD, Figures, cell, quantile_row, show_machine, table

USAGE = "usage: python -m bench.isolation compare A.json B.json | summary RESULT.json | table DIR"
SHIELDED = "; during the run a shield moved them away"  # the tasks that may run on the Spine's core
OF_BOARDS = [f"r999_{each}_{{}}" for each in ("floor", "cyclictest", "plain_loop")]
OF_BOARDS += ["lithe_{}_p999_us", "handoff_{}_p999_us"]  # the columns of boards()


class Unreadable(Exception):
    """A file that is no result of this bench; the text says why."""


def measured(told: Figures) -> list[str]:
    """The workloads of a result."""
    return [name for name in WORKLOADS if f"cycles_{name}" in told]


def over(told: Figures, key: str) -> str:
    """A ratio and its interval."""
    if told.get(key) is None:
        return "-"
    low, high = (cell(told, f"{key}_{end}", ".3g") for end in ("low", "high"))
    return f"{told[key]:.3g} ({low} .. {high})"


def ratios(told: Figures) -> None:
    """The claims: p99.9 over the floors and over each peer."""
    names = {"floor": "the floor", "writing": "the spin that writes", **{peer: WORDS[peer] for peer in PEERS}}
    rows = [[name, *(over(told, f"r999_{each}_{name}") for each in names)] for name in measured(told)]
    table("p99.9 of LITHE's release jitter, steal-aware, over that of (95 % interval)", ["", *names.values()], rows)


def by_cause(told: Figures, name: str, program: str, floor: str) -> str:
    """How many cycles of a program, and of the floor beside it, were above 20 us, by cause."""
    counts = {each: [told[f"{who}_{name}_over_20us_{each}"] for who in (program, floor)] for each in CAUSES}
    return ", ".join(f"{each} {ours} ({floors})" for each, (ours, floors) in counts.items() if ours or floors) or "none"


def work(told: Figures) -> None:
    """How long a tick works, beside a spin that only writes what a tick writes."""
    rows = []
    for name in measured(told):
        for program, words in (("writing", "the spin that writes"), ("lithe", "LITHE")):
            row = quantile_row(f"{name}, {words}", told, f"work_{program}_{name}")
            rows.append([*row, over(told, f"r999_work_{name}") if program == "lithe" else ""])
    table("work of a tick, from wake-up to its end, steal-aware [us]", [*HEAD, "p99.9, LITHE's over the spin's"], rows)


def shares(told: Figures, name: str) -> None:
    """One workload: quantiles and shares of all programs."""
    print(f"\n{name}: {told.get(f'load_{name}', '')}")
    if name == "swap":
        swaps = cell(told, "second_robot_swaps", ".0f")
        print(
            f"  {cell(told, 'rig_offers', '.0f')} laws offered to the measured Spine; {swaps} swaps of the second robot"
        )
    if name == "numpy" and told.get("rogue_looks"):
        looks = f"{told['rogue_share_on_spine_core']:.1%} of the {told['rogue_looks']} looks"
        print(f"  the rogue program: {told['rogue_threads']} threads, which may use {told['rogue_may_use']}, ", end="")
        print(f"ran on {told['rogue_ran_on']}, {looks} on the Spine's core")
    rows = []
    for program, words in WORDS.items():
        if told.get(f"{program}_{name}_p50_us") is not None:
            late = [cell(told, f"{program}_{name}_over_{limit_us}us", ".3%") for limit_us in LIMITS_US]
            rows.append([*quantile_row(words, told, f"{program}_{name}"), *late])
    head = [*HEAD, *(f"> {limit_us} us" for limit_us in LIMITS_US)]
    table("release jitter, steal-aware [us], and shares of cycles later than", head, rows)
    missed = {each: told[f"missed_deadlines_{name}_{each}"] for each in CAUSES}
    of_missed = ", ".join(f"{each} {count}" for each, count in missed.items() if count)
    print(f"  LITHE: {told[f'cycles_{name}']} cycles, stolen {cell(told, f'steal_share_{name}', '.2%')} (", end="")
    print(f"{cell(told, f'steal_share_kernel_{name}', '.2%')} of the core's time, as the kernel counts), ", end="")
    print(f"preempted {cell(told, f'preempted_share_{name}', '.2%')}")
    print(f"  cycles above 20 us of LITHE (of the floor) by cause: {by_cause(told, name, 'lithe', 'floor')}; ", end="")
    print(
        f"missed deadlines: {told[f'missed_deadlines_{name}']} ({of_missed or 'none'}); causes by {told['attribution']}"
    )
    print("  work above 20 us of LITHE (of the spin that writes) by cause: ", end="")
    print(by_cause(told, name, "work_lithe", "work_writing"))


def show(told: Figures) -> None:
    """Everything about one result."""
    show_machine(told)
    print(f"  shielded: {told['shielded']}; loads on cores {told['loads_cores']}")
    ratios(told)
    for name in measured(told):
        shares(told, name)
    work(told)
    rows = [quantile_row(name, told, f"handoff_{name}") for name in measured(told)]
    table(f"hand-off time of LITHE [us]; the paper's worst is {PAPER_HANDOFF_US:.1f}", HEAD, rows)
    each_us: list[Any] = [told.get(f"lithe_{name}_max_us") for name in measured(told)]
    worst = "unknown" if None in each_us or not each_us else f"{max(each_us):.2f} us"
    print(f"  release jitter: worst {worst} steal-aware; the paper's worst is {PAPER_JITTER_US:.2f}")
    print(f"  negative control, another busy thread on the core: {cell(told, 'control_over_floor', '.0f')} x the floor")
    for peer in PEERS:
        if told.get(f"{peer}_absent"):
            print(f"  not measured: {WORDS[peer]}: {told[f'{peer}_absent']}")
    print(f"\nverdict: {told['verdict']}" + (f": {told['reason']}" if told["reason"] else ""))
    if told.get("isolation_runs"):
        print(f"  run {told['isolation_runs']} of those in isolation.runs.jsonl")
    if told["conclusive_with"]:
        print(f"  next: {told['conclusive_with']}")


def text(told: Figures) -> str:
    """The same as text."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        show(told)
    return out.getvalue()


def load(path: Path) -> Figures:
    """A result; Unreadable when it is none."""
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as why:
        raise Unreadable(f"{path}: {why}") from None
    if not isinstance(told, dict) or "verdict" not in told or not measured(told):
        raise Unreadable(f"{path}: no result of `make bench-isolation`")
    return told


def rates(told: Figures) -> Figures:
    """A result, and its counts as shares of the cycles: two runs may differ in length."""
    shares = {name: told.get(f"missed_deadlines_{name}", 0) / max(told[f"cycles_{name}"], 1) for name in measured(told)}
    return told | {f"missed_deadlines_share_{name}": share for name, share in shares.items()}


def compare(one: Figures, other: Figures) -> str:
    """Two results beside each other, and the second over the first."""
    rows = [["verdict", str(one["verdict"]), str(other["verdict"]), ""]]
    rows += [[key, str(one.get(key)), str(other.get(key)), ""] for key in ("machine_cpu", "machine_kernel", "shielded")]
    one, other = rates(one), rates(other)
    for name in WORKLOADS:
        words = [f"load_{name}", *(f"cycles_{each}{name}" for each in ("", *(f"{peer}_" for peer in PEERS)))]
        rows += [[key, str(one.get(key)), str(other.get(key)), ""] for key in words if key in one or key in other]
        keys = [f"r999_{each}_{name}" for each in ("floor", "writing", "work", *PEERS)]
        keys += [f"{each}_{name}_p999_us" for each in ("floor", "lithe", "handoff", *PEERS)]
        shares = ("missed_deadlines_share", "steal_share", "steal_share_kernel", "preempted_share")
        for key in (*keys, *(f"{each}_{name}" for each in shares)):
            a, b = one.get(key), other.get(key)
            if a is not None or b is not None:
                change = f"{b / a:.2f}" if a and b is not None else "-"
                rows.append([key, cell(one, key, ".4g"), cell(other, key, ".4g"), change])
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        table("two results", ["", "A", "B", "B / A"], rows)
    return out.getvalue()


def worst(told: Figures, key: str) -> str:
    """The largest of all workloads, and whose it is; a dash when one of them has no figure."""
    found = {name: told.get(key.format(name)) for name in measured(told)}
    if None in found.values():
        return "-"
    name = max(found, key=lambda each: found[each] or 0.0)
    return f"{format(found[name], ',.0f' if (found[name] or 0.0) >= 1000 else '.3g')} ({name})"


def boards(folder: Path) -> str:
    """The table of docs/host.md: a row for each result in the folder, the worst of its workloads in each column."""
    lines = [
        "| board | kernel | Spine's core | over the bare spin | over cyclictest | over the plain loop | "
        "release jitter p99.9 [µs] | hand-off p99.9 [µs] | verdict |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for path in sorted(folder.glob("*.json")):
        told = load(path)
        isolation = str(told.get("machine_spine_core_isolation", "unknown")) + SHIELDED * bool(told["shielded"])
        board = f"{path.stem}: {told['machine_cpu']}, {told['machine_cores']} cores"
        cells = [board, str(told["machine_kernel"]), isolation]
        cells += [worst(told, key) for key in OF_BOARDS]
        lines.append("| " + " | ".join(each.replace("|", "/") for each in (*cells, str(told["verdict"]))) + " |")
    return "\n".join(lines) + "\n"


def summary(told: Figures) -> Figures:
    """What of a result goes into the folder of boards()."""
    kept = ["verdict", "reason", "shielded", "steal_share", "attribution", "isolation_measured_at"]
    kept += [f"machine_{each}" for each in ("cpu", "cores", "virtual", "kernel", "spine_core_isolation")]
    each_has = ["load_{}", "cycles_{}", "steal_share_{}", "steal_share_kernel_{}", "missed_deadlines_{}", *OF_BOARDS]
    kept += [key.format(name) for name in measured(told) for key in each_has]
    return {key: told[key] for key in kept if key in told}


def main(words: list[str]) -> int:
    """`compare A.json B.json`, `summary RESULT.json` or `table DIR`."""
    try:
        match words:
            case ["compare", one, other]:
                print(compare(load(Path(one)), load(Path(other))), end="")
            case ["summary", one]:
                print(json.dumps(summary(load(Path(one))), indent=2))
            case ["table", folder] if Path(folder).is_dir():
                print(boards(Path(folder)), end="")
            case ["table", folder]:
                raise Unreadable(f"{folder} is no folder")
            case _:
                print(USAGE, file=sys.stderr)
                return 2
    except Unreadable as why:
        print(f"bench: {why}", file=sys.stderr)
        return 2
    return 0
