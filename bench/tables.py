# SPDX-License-Identifier: Apache-2.0
"""Prints the figures as tables. A figure that was not measured is a dash."""

from typing import Any

Figures = dict[str, Any]
QUANTILES = ("p50", "p99", "p999", "max")
HEAD = ["", "p50", "p99", "p99.9", "max"]


def cell(figures: Figures, key: str, form: str = ".2f") -> str:
    """One figure, or a dash."""
    value = figures.get(key)
    return "-" if value is None else format(value, form)


def table(title: str, head: list[str], rows: list[list[str]]) -> None:
    """Prints aligned columns, the first to the left and the others to the right."""
    widths = [max(len(row[column]) for row in [head, *rows]) for column in range(len(head))]
    print(f"\n{title}")
    for first, *others in [head, *rows]:
        cells = [f"{first:<{widths[0]}}", *(f"{text:>{w}}" for text, w in zip(others, widths[1:], strict=True))]
        print("  " + "  ".join(cells).rstrip())


def quantile_row(name: str, figures: Figures, key: str) -> list[str]:
    """One row of p50, p99, p99.9 and max in microseconds."""
    return [name, *(cell(figures, f"{key}_{q}_us") for q in QUANTILES)]


def show_channel(figures: Figures) -> None:
    """The Channel and its peers."""
    plan = f"{cell(figures, 'plan_bytes', '.0f')} bytes"
    kinds = [
        ("raw cache line, 56 bytes (floor)", "cache_line"),
        ("raw atomic word", "one_word"),
        ("Channel, 56 bytes", "channel_56"),
        ("Channel, 256 bytes", "channel_256"),
        (f"raw words of a plan, {plan}", "raw_plan"),
        (f"Channel, a plan, {plan}", "channel_plan"),
        ("Unix datagram, 256 bytes", "unix_datagram"),
        ("ZeroMQ ipc PAIR, 256 bytes", "zeromq"),
    ]
    rows = [[*quantile_row(name, figures, key), cell(figures, f"{key}_over_pingpong")] for name, key in kinds]
    table("one-way latency between two cores, both sides polling [us]", [*HEAD, "x floor"], rows)
    print(f"  Channel of 56 bytes: {cell(figures, 'channel_latency_over_pingpong')} x a raw line of 56 bytes, ", end="")
    print(f"{cell(figures, 'channel_56_over_one_word')} x a raw word; ", end="")
    print(f"of a plan: {cell(figures, 'channel_plan_over_raw')} x its raw words")
    print(
        f"  control: both sides on one core: {cell(figures, 'control_same_core_over_pingpong', '.0f')} x floor; ",
        end="",
    )
    print(f"interquartile range of the rounds {cell(figures, 'channel_round_spread', '.0%')}")


def show_jitter(figures: Figures) -> None:
    """Release jitter, its floor, and cyclictest."""
    kinds = [
        ("bare spin, steal-aware (floor)", "floor"),
        ("a spin that writes what a tick writes", "writing"),
        ("LITHE, steal-aware", "lithe"),
        ("bare spin, raw", "floor_raw"),
        ("LITHE, raw", "lithe_raw"),
        ("cyclictest, raw", "cyclictest"),
        ("control: another thread on the core", "control"),
        ("hand-off: wake-up to command out", "handoff"),
        ("hand-off, raw", "handoff_raw"),
        ("work of a tick: wake-up to its end", "work"),
        ("work of the spin that writes", "writing_work"),
    ]
    table(
        "release jitter at 1 kHz, in blocks that alternate [us]", HEAD, [quantile_row(n, figures, k) for n, k in kinds]
    )
    print(f"  p99.9 over floor: {cell(figures, 'release_jitter_p999_over_floor')} (raw ", end="")
    print(f"{cell(figures, 'release_jitter_p999_over_floor_raw')}, control ", end="")
    print(f"{cell(figures, 'control_over_floor', '.0f')}); over cyclictest, raw: ", end="")
    print(cell(figures, "release_jitter_p999_over_cyclictest", ".3f"))
    print(
        f"  {cell(figures, 'jitter_cycles', '.0f')} cycles, stolen {cell(figures, 'jitter_stolen_share', '.2%')}, ",
        end="",
    )
    print(f"preempted {cell(figures, 'jitter_preempted_share', '.2%')}")


def show_cost(figures: Figures) -> None:
    """The time of a tick without its law."""
    rows = [quantile_row(f"{joints} joints", figures, f"tick_cost_{joints}j") for joints in (1, 8, 32)]
    table("the tick's own cost, without the law [us]", HEAD, rows)
    print(f"  control: 32 joints over 1 joint: {cell(figures, 'cost_control_32j_over_1j')}")


def show_contain(figures: Figures) -> None:
    """The time of containment, and from a fault to the end of the replacement step."""
    ways = [
        ("plain", "plain"),
        ("contained", "contained"),
        ("contained, memory protected by keys", "contained_keys"),
        ("contained, 4 KiB copied", "contained_copies_4k"),
        ("contained, system calls blocked", "contained_gated"),
        ("control: signal mask saved", "control"),
    ]
    rows = [[name, cell(figures, f"contain_call_ns_{key}", ".1f")] for name, key in ways]
    table("one call of a law that does almost nothing [ns]", ["", "p50"], rows)
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
    rows = [quantile_row(name, figures, f"contain_{key}") for name, key in kinds]
    table("from a law's fault to the end of the replacement step [us]", HEAD, rows)
    print(f"  the watchdog takes {cell(figures, 'contain_watchdog_core_share', '.1%')} of its core")


def show_scale(figures: Figures) -> None:
    """The time that more joints take, and our codec compared with others."""
    sizes = (1, 4, 12, 32)
    rows = [[*quantile_row("no joints (floor)", figures, "exchange_empty"), "1.00"]]
    for key, name in (("exchange", ""), ("simulated", ", 1 ms of physics each")):
        for n in sizes:
            row = quantile_row(f"{n} joints{name}", figures, f"{key}_{n}j")
            rows.append([*row, cell(figures, f"{key}_{n}j_over_empty")])
    table("one exchange with simulated moteus drives on a bus in memory, without pauses [us]", [*HEAD, "x floor"], rows)
    for key, title in (("transport", "the Transport's exchange"), ("tick", "the tick, without its law")):
        rows = [quantile_row(f"{n} joints", figures, f"scale_{key}_{n}j") for n in sizes]
        table(f"{title}, in a Spine at 1 kHz [us]", HEAD, rows)
    print(f"  control: 32 joints over 1 joint: {cell(figures, 'scale_control_32j_over_1j')}")
    rows = []
    for key, name in (("lithe", "LITHE"), ("upstream", "the maker's C++"), ("python", "the maker's Python")):
        row = [name, *(cell(figures, f"codec_{key}_{part}_ns", ".0f") for part in ("encode", "parse"))]
        rows.append([*row, *(cell(figures, f"codec_{key}_over_lithe_{part}", ".1f") for part in ("encode", "parse"))])
    head = ["", "command", "answer", "x LITHE", "x LITHE"]
    table("writing a moteus command and reading its answer, the same frames [ns per frame]", head, rows)
    for key in ("codec_absent", "codec_upstream_absent"):
        if figures.get(key):
            print(f"  not measured: {figures[key]}")
    if figures.get("scale_short"):
        print("  a short run: few rounds")


def show_release(figures: Figures) -> None:
    """Jitter against processor time, for each way in which the Spine can wait."""
    rows = [
        [
            *quantile_row(way, figures, f"release_{way}"),
            cell(figures, f"release_{way}_over_20us", ".3%"),
            cell(figures, f"release_{way}_over_100us", ".3%"),
            cell(figures, f"release_{way}_processor_share", ".1%"),
        ]
        for way in ("spin", "hybrid", "sleep")
    ]
    head = [*HEAD, "> 20 us", "> 100 us", "processor"]
    table("late releases at 1 kHz by the way of waiting, raw [us]", head, rows)
    print(f"  a hybrid wait spins through the last {cell(figures, 'release_window_us', '.0f')} us here")


def show_host(figures: Figures) -> None:
    """The machine without LITHE: the numbers of docs/rt.md."""
    rows = [quantile_row(name, figures, f"host_touch_{key}") for name, key in (("first", "first"), ("again", "again"))]
    table("a write to a page of new memory [us]", HEAD, rows)
    names = {"whole": "on whole milliseconds", "moved": "shifted by 500 us", "quarter": "control: shifted by 250 us"}
    rows = [
        [name, cell(figures, f"host_grid_{key}_late_share", ".2%"), cell(figures, f"host_grid_{key}_p99_us")]
        for key, name in names.items()
    ]
    table("releases of a bare spin at 1 kHz", ["", "more than 2 us late", "p99 [us]"], rows)
    names = {"alone": "alone", "ordinary": "with another thread", "raised": "the same, with nice -20"}
    rows = [[name, cell(figures, f"host_nice_{key}_skipped_share", ".2%")] for key, name in names.items()]
    table("releases of a bare spin that were skipped", ["", "share"], rows)
    names = {"plain": "the session at 0", "raised": "the session at -20"}
    rows = [[name, cell(figures, f"host_session_{key}_core_share", ".1%")] for key, name in names.items()]
    table("a spin with nice -20, and nice 10 in another session", ["", "share of the core"], rows)
    rows = [
        [
            f"{name}, threads: {cell(figures, f'host_brain_{key}_threads', '.0f')}",
            *(cell(figures, f"host_brain_{key}_{rest}", ".1f") for rest in ("alone_per_s", "beside_per_s", "slower")),
            *(cell(figures, f"host_brain_{key}_slower_{end}", ".1f") for end in ("least", "most")),
        ]
        for name, key in (("numpy's default", "own"), ("control: on the Brain's core", "one"))
    ]
    head = ["", "alone", "with a spin", "x slower", "least", "most"]
    table("numpy: inversions of 600 x 600 per second", head, rows)
    for key in ("host_nice_absent", "host_session_absent"):
        if figures.get(key):
            print(f"  not measured: {figures[key]}")
    print(f"  stolen {cell(figures, 'host_stolen_share', '.2%')}, ", end="")
    print(f"preempted {cell(figures, 'host_preempted_share', '.2%')}")
    if figures.get("host_short"):
        print("  a short run: one round")


def show_run(figures: Figures) -> None:
    """The real process, `lithe run`."""
    kinds = [
        ("release jitter, raw", "run_release_jitter"),
        ("hand-off, raw", "run_handoff"),
        ("control: another thread on the core", "run_control"),
    ]
    table(
        "lithe run robots/arm.toml, from its own histograms [us]", HEAD, [quantile_row(n, figures, k) for n, k in kinds]
    )
    print(
        f"  {cell(figures, 'run_releases', '.0f')} releases, {cell(figures, 'run_skipped_releases', '.0f')} skipped, ",
        end="",
    )
    print(f"stolen {cell(figures, 'run_stolen_share', '.2%')}, preempted {cell(figures, 'run_preempted_share', '.2%')}")


def show_machine(figures: Figures) -> None:
    """The machine on which all this was measured."""
    kind = "virtual machine" if figures["machine_virtual"] else "bare metal"
    usable = figures.get("machine_usable_cores", figures["machine_cores"])
    some = "" if usable == figures["machine_cores"] else f" ({usable} of them usable)"
    print(
        f"{figures['machine_cpu']}, {figures['machine_cores']} cores{some}, {kind}, Linux {figures['machine_kernel']}"
    )
    isolated = figures["machine_isolated_cores"] or "none"
    print(f"  isolated cores: {isolated}; governor: {figures['machine_governor']}; ", end="")
    print(f"clock: {figures['machine_clock_source']}; {'root' if figures['measured_as_root'] else 'no root'}")
    if "machine_spine_core" in figures:
        print(
            f"  the Spine's core: {figures['machine_spine_core']}, {figures['machine_spine_core_isolation']}; ", end=""
        )
        print(f"its partner's: {figures['machine_partner_core']}, {figures['machine_partner_core_isolation']}")
        print(f"  the Spine's core: {figures['machine_spine_core_interrupts']}")
