# SPDX-License-Identifier: Apache-2.0
"""What made a release late, by the kernel's trace of switches and interrupts."""

import gzip
import os
import subprocess
from pathlib import Path
from types import ModuleType

import pytest
from isolation_records import module, records


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The bench's own module."""
    return module("figures", monkeypatch)


SWITCH = "sched_switch: prev_comm=a prev_pid=1 prev_prio=120 prev_state=R ==> next_comm=b next_pid={} next_prio=120"
OWN, WORKER, SHELL = 50, 60, 70  # threads: the measured one, the kernel's, a task of somebody
TRACES = {  # of a release that was due at 10.001 s and woke 200 us later
    "kernel_thread": [(1000, SWITCH.format(WORKER)), (1150, SWITCH.format(SHELL)), (1180, SWITCH.format(OWN))],
    "other_task": [(500, SWITCH.format(SHELL)), (1150, "local_timer_entry: vector=236"), (1190, SWITCH.format(OWN))],
    "tick": [(980, "local_timer_entry: vector=236"), (990, "local_timer_exit: vector=236")],
    "interrupt": [(1100, "irq_handler_entry: irq=24 name=virtio0"), (1101, "irq_handler_exit: irq=24 ret=handled")],
    "unknown": [(900, "local_timer_entry: vector=236"), (1300, SWITCH.format(SHELL)), (1400, SWITCH.format(OWN))],
}


def trace_of(lines: list[tuple[int, str]]) -> str:
    """As trace_pipe has it; times are us after 10 s."""
    return "\n".join(f"  stress-{SHELL}  [001] d..2.    10.{at_us:06d}: {what}" for at_us, what in lines)


@pytest.mark.parametrize("wanted", TRACES)
def test_the_kernels_trace_tells_what_made_a_release_late(
    figures: ModuleType, monkeypatch: pytest.MonkeyPatch, wanted: str
) -> None:
    attribution = module("attribution", monkeypatch)
    made = records(figures, [0.5, 200.0], switches=1)
    made["release_ns"] = 10_001_000_000
    ran = attribution.spans(trace_of(TRACES[wanted]), {OWN}, lambda pid: pid == WORKER)
    overran = made.copy()
    overran["told"][1] = 1 + figures.CAUSES.index("ours")  # as bench_isolation writes it
    attribution.attribute(made, ran)
    attribution.attribute(overran, ran)
    assert figures.CAUSES[figures.cause(made)[1]] == wanted
    explained = wanted in ("kernel_thread", "other_task")  # at least half of it
    assert figures.CAUSES[figures.cause(overran)[1]] == (wanted if explained else "ours")
    assert made["told"][0] == 0, "what was not late has no cause"
    made["switches"], made["stolen_ns"] = 0, 150_000
    assert figures.CAUSES[figures.cause(made)[1]] == "hypervisor", "time that the guest did not have comes first"


def test_the_timer_of_an_arm_is_a_tick_and_a_task_at_the_end_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    attribution = module("attribution", monkeypatch)
    lines = [(5, "irq_handler_entry: irq=11 name=arch_timer"), (6, SWITCH.format(SHELL)), (9, "softirq_exit: vec=1")]
    ran = attribution.spans(trace_of(lines), {OWN}, lambda _: False)
    assert [each[2] for each in ran] == [attribution.TICK, attribution.OTHER_TASK]
    assert ran[1][:2] == (10_000_006_000, 10_000_009_000)


@pytest.mark.parametrize(
    ("at_us", "apart", "wanted"),
    [
        (1100, False, "hypervisor"),  # the kernel counts an interrupt as the thread's own time: this is none
        (1100, True, "interrupt"),
        (100, True, "unknown"),  # less than a period before the release, when the time began to count
        (1900, True, "unknown"),
        (-100, True, "hypervisor"),
        (2300, True, "hypervisor"),
    ],
)
def test_what_an_interrupt_may_have_taken_is_not_the_hypervisors(
    figures: ModuleType, monkeypatch: pytest.MonkeyPatch, at_us: int, apart: bool, wanted: str
) -> None:
    attribution = module("attribution", monkeypatch)
    trace = attribution.Trace(1, apart=apart)
    line = f"  stress-{SHELL}  [001] d..2.    {10 + at_us * 1e-6:.6f}: irq_handler_entry: irq=24 name=virtio0"
    monkeypatch.setattr(trace, "read", lambda: line)
    made = records(figures, [200.0], stolen_us=150)
    made["release_ns"] = 10_001_000_000
    trace.attribute(made, os.getpid())
    assert figures.CAUSES[figures.cause(made)[0]] == wanted
    assert len(figures.calm([made])[0]) == (wanted != "hypervisor") and trace.untraced == 0


def test_an_interrupt_explains_a_part_of_what_was_stolen(figures: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """When the hypervisor gives the core back, the timer's interrupt is there at once."""
    trace, made = module("attribution", monkeypatch).Trace(1, apart=True), records(figures, [1500.0], stolen_us=1500)
    line = f"  stress-{SHELL}  [001] d..2.    10.002499: local_timer_entry: vector=236"
    monkeypatch.setattr(trace, "read", lambda: line)
    made["release_ns"] = 10_001_000_000
    trace.attribute(made, os.getpid())
    assert figures.CAUSES[figures.cause(made)[0]] == "hypervisor"


def test_what_a_kernel_leaves_out_of_a_threads_time_is_read_from_its_configuration(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    accounting = module("attribution", monkeypatch).accounting
    packed, plain = tmp_path / "config.gz", tmp_path / "config-6.1"
    assert set(accounting((packed, plain)).values()) == {None}, "no file: unknown"
    plain.write_text("# CONFIG_IRQ_TIME_ACCOUNTING is not set\nCONFIG_PARAVIRT_TIME_ACCOUNTING=y\n")
    wanted = {"machine_irq_time_accounting": False, "machine_steal_accounting": True}
    assert accounting((packed, plain)) == wanted
    packed.write_bytes(b"no gzip")
    assert accounting((packed, plain)) == wanted, "the next file is asked"
    packed.write_bytes(gzip.compress(b"CONFIG_IRQ_TIME_ACCOUNTING=y\nCONFIG_HAVE_PARAVIRT_TIME_ACCOUNTING=y\n"))
    assert accounting((packed, plain)) == dict.fromkeys(wanted, False) | {"machine_irq_time_accounting": True}


def test_without_a_trace_nothing_is_attributed_and_the_reason_is_told(
    figures: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    attribution = module("attribution", monkeypatch)
    made = records(figures, [200.0])
    with attribution.Trace(1, tmp_path / "nowhere") as trace:
        trace.attribute(made, os.getpid())
    assert "mount -t tracefs" in trace.why_not and made["told"][0] == 0 and trace.untraced == 1


def test_a_block_of_whose_trace_some_was_lost_is_counted(
    figures: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    trace, made = module("attribution", monkeypatch).Trace(1, tmp_path), records(figures, [200.0])
    piece = iter([b"CPU:1 [LOST 5 EVENTS]\n", trace_of(TRACES["interrupt"]).encode(), b"", b""])
    monkeypatch.setattr(os, "read", lambda *_: next(piece))
    monkeypatch.setattr(trace, "_pipe", 1000)
    trace.attribute(made, os.getpid())
    assert (trace.untraced, made["told"][0]) == (1, 0)
    trace.attribute(made, os.getpid())
    assert trace.untraced == 1, "the next block is whole: nothing came"


def test_a_trace_of_this_kernel_is_read_and_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """Switches of a core on which a task sleeps and wakes; where root reads tracefs."""
    attribution = module("attribution", monkeypatch)
    core = min(os.sched_getaffinity(0))
    with attribution.Trace(core) as trace:
        if trace.why_not:
            pytest.skip(f"without the privilege of reading the trace: {trace.why_not}")
        for _ in range(20):
            subprocess.run(["taskset", "-c", str(core), "sleep", "0.01"], check=True)
        text = trace.read() or ""
    assert any(cause == attribution.OTHER_TASK for _, _, cause in attribution.spans(text, set())), text[:2000]
    assert not (attribution.TRACEFS / "instances" / attribution.INSTANCE).exists()
