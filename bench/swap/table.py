# SPDX-License-Identifier: Apache-2.0
"""Prints the figures of `make bench-swap` as tables."""

from __future__ import annotations

from bench.swap.host import COUNTED
from bench.swap.stats import LIMITS_US
from bench.tables import Figures, cell, show_machine, table

WAYS = (
    ("LITHE", ""),
    ("dlopen in the loop", "peer_dlopen_"),
    ("behind a mutex", "peer_mutex_"),
    ("mutex for the exchange only", "peer_brief_"),
    ("control: compiles in the loop", "peer_compile_"),
)
STAGES = ("started", "compiled", "admitted", "placed", "tried", "staged", "shadow", "committed")


def show(told: Figures) -> None:
    """Everything."""
    show_machine(told)
    show_lost(told)
    show_late(told)
    show_core(told)
    show_stages(told)


def show_verdict(told: Figures) -> None:
    """The verdict and its reasons."""
    why = f" ({told['swap_reason']})" if told["swap_reason"] else ""
    print(f"\n  swap: {told['swap_verdict']}{why}; load {cell(told, 'swap_load_before', '.1f')} before, ", end="")
    print(f"{cell(told, 'swap_load_after', '.1f')} after")


def show_runs(runs: list[Figures]) -> None:
    """Every run that was measured here, the last one at the end."""
    rows = []
    for told in runs:
        row = [f"{told['swap_measured_at']} {told['code']}", f"{told['swaps']}", str(told["swap_verdict"])]
        for limit_us in LIMITS_US:
            key = f"trial_jitter_over_{limit_us}us_difference"
            row.append(" .. ".join(cell(told, f"{key}_{end}", "+.3%") for end in ("low", "high")))
        rows.append(row)
    head = ["", "swaps", "verdict", *(f"> {limit_us} us (95 %)" for limit_us in LIMITS_US)]
    table("all runs here: share of late ticks while swapping minus that beside trials alone", head, rows)


def show_lost(told: Figures) -> None:
    """Lost ticks, both counts, and the interval of the difference."""
    rows = []
    for name, key in WAYS:
        low, high = (cell(told, f"{key}lost_rate_difference_{end}_per_s", "+.3f") for end in ("low", "high"))
        rows.append(
            [
                name,
                cell(told, f"{key}swaps", ".0f"),
                f"{cell(told, f'{key}lost_ticks_in', '.0f')} in {cell(told, f'{key}seconds_in', '.1f')} s",
                f"{cell(told, f'{key}lost_ticks_out', '.0f')} in {cell(told, f'{key}seconds_out', '.1f')} s",
                f"{low} .. {high}",
                cell(told, f"{key}lost_ticks_attributable", ".0f"),
                cell(told, f"{key}max_output_step_nm", ".4f"),
            ]
        )
    head = [
        "",
        "swaps",
        "lost, swapping",
        "lost, at rest",
        "difference/s, 95 %",
        "caused by swaps",
        "largest step [Nm]",
    ]
    table("lost ticks at 1 kHz, while swapping and at rest in the same run", head, rows)
    print(
        f"  largest step at rest: {cell(told, 'max_output_step_at_rest_nm', '.4f')} Nm; slew bound of the arm, ",
        end="",
    )
    print(f"set very high here: {cell(told, 'slew_bound_nm', '.4f')} Nm per tick; certificates: ", end="")
    print(f"{cell(told, 'certificates', '.0f')} of {cell(told, 'swaps_wanted', '.0f')}; rolled back: ", end="")
    print(f"{cell(told, 'swaps_rolled_back', '.0f')}; safe stops: ", end="")
    print(f"{cell(told, 'safe_stops', '.0f')}; windows with a loss: ", end="")
    print(f"{told['lossy_windows_in']} of {told['windows_in']}, at rest {told['lossy_windows_out']} of ", end="")
    print(f"{told['windows_out']} (p = {cell(told, 'lossy_windows_chance', '.2g')})")


def show_late(told: Figures) -> None:
    """Share of late ticks, and p99.9, for the release and for the output of the command."""
    beside = ("LITHE, beside trials alone", "trial_")
    for what, words in (("jitter", "the release"), ("output", "the output of the command")):
        rows = []
        for name, key in (WAYS[0], beside, *WAYS[1:]) if what == "jitter" else WAYS:
            row = [name, *(cell(told, f"{key}{what}_p999_{side}_us", ".1f") for side in ("in", "out"))]
            for limit_us in LIMITS_US:
                at = f"{key}{what}_over_{limit_us}us"
                low, high = (cell(told, f"{at}_difference_{end}", "+.3%") for end in ("low", "high"))
                row.append(f"{cell(told, f'{at}_in', '.3%')} - {cell(told, f'{at}_out', '.3%')} ({low} .. {high})")
            rows.append(row)
        head = ["", "p99.9 [us]", "at rest", *(f"> {limit_us} us: swapping - at rest (95 %)" for limit_us in LIMITS_US)]
        table(f"late ticks, steal-aware: {words}", head, rows)
    print(f"  the Spine's core: stolen {cell(told, 'stolen_share', '.2%')}, ", end="")
    print(f"preempted {cell(told, 'preempted_share', '.2%')}")


def show_core(told: Figures) -> None:
    """The effect of a swap on the Spine's core and on memory."""
    rows = []
    for name, key in (("arena", ""), ("[spine] loader = dlopen", "loader_dlopen_")):
        names = (*COUNTED, "page_faults")
        counts = (cell(told, f"{key}{n}_per_swap") for n in names)
        rows.append([name, cell(told, f"{key}swaps", ".0f"), *counts, cell(told, f"{key}load_p50_us", ".0f")])
    head = ["", "swaps", "TLB", "CAL", "RES", "LOC", "devices", "page faults", "load [us]"]
    table("interrupts on the Spine's core and faults of its thread, per swap, minus those at rest", head, rows)
    grown = ", ".join(
        f"{name} {' -> '.join(cell(told, f'{name}_rss_kb_{when}', '.0f') for when in ('start', 'middle', 'end'))} kB"
        for name in ("spine", "supervisor", "lawd")
    )
    print(f"  resident memory: {grown}; arena {cell(told, 'arena_kb', '.0f')} kB, ", end="")
    print(f"{cell(told, 'arena_slots_in_use', '.0f')} of {cell(told, 'arena_slots', '.0f')} slots in use")


def show_stages(told: Figures) -> None:
    """The time of a swap by stage."""
    known = [(stage, f"stage_{stage}") for stage in STAGES] + [("requested to committed", "requested_to_committed")]
    known = [(name, key) for name, key in known if f"{key}_p50_ms" in told]
    rows = [[name, cell(told, f"{key}_p50_ms"), cell(told, f"{key}_p99_ms")] for name, key in known]
    table("from request to commit, law compiled before, time of each stage [ms]", ["", "p50", "p99"], rows)
