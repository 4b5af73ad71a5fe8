# SPDX-License-Identifier: Apache-2.0
"""`make bench-isolation`: its programs, loads and shield, and a whole run. Its verdict: test_bench_isolation.py."""

import contextlib
import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from isolation_records import module
from system.robot_rig import need

ROOT = Path(__file__).parents[2]


def test_swaps_count_from_the_start_of_the_rounds(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    run = module("run", monkeypatch)
    bench, log, done = run.Bench.__new__(run.Bench), tmp_path / "loads.log", iter(range(1, 100))

    def swap() -> None:
        log.write_text("".join(f"{number + 1} {run.loads.SWAPS}\n" for number in range(next(done))))

    @contextlib.contextmanager
    def running(*_: Any) -> Iterator[list[Any]]:
        for _ in range(5):
            swap()
        yield []
        swap()

    def offers(self: Any, on: bool) -> int:
        return 7 if on else 47

    bench.plan, bench.folder, bench.spine, bench.brain, bench.all = run.Plan(["swap"], 3, 1, 1.0), tmp_path, 0, 0, [0]
    bench.load_cores, bench.confined, bench.seen, bench.told = "0", False, {}, {}
    monkeypatch.setattr(run, "one_round", lambda *_: swap())
    monkeypatch.setattr(run.loads, "running", running)
    bench.under("swap", type("Subject", (), {"offers": offers})(), None)
    assert (bench.told["second_robot_swaps"], bench.told["rig_offers"]) == (3, 40)


def test_programs_that_are_missing_are_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    programs, loads = module("programs", monkeypatch), module("loads", monkeypatch)
    monkeypatch.setenv("LITHE_BIN_DIR", str(tmp_path))
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(programs.subprocess, "run", lambda *_, **__: subprocess.CompletedProcess([], 1, "", "no pip"))
    peers = programs.Peers(None, [0], 0, tmp_path)
    assert "bench_plain_loop is missing" in peers.absent["plain_loop"] and peers.absent["moteus_loop"] == "no pip"
    assert "install -y --no-install-recommends rt-tests" in peers.absent["cyclictest"]
    assert all(peers.records(name, 1.0) is None for name in ("cyclictest", "plain_loop", "moteus_loop"))
    assert "stress-ng is missing: sudo apt-get install" in loads.stress("0", 1).words


def test_without_the_verb_shield_says_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = module("run", monkeypatch)
    lithe = tmp_path / "lithe"
    lithe.write_text("#!/bin/sh\nexit 2\n")
    lithe.chmod(0o755)
    monkeypatch.setenv("LITHE_BIN_DIR", str(tmp_path))
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        assert run.main(["--shield", "--short"]) == 2
        assert {signal.getsignal(number) for number in before} == {signal.default_int_handler}, "a lost terminal, too"
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        assert run.main(["--shield", "--short"]) == 2 and signal.getsignal(signal.SIGHUP) == signal.SIG_IGN, "nohup"
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert "has no `tune shield`" in capsys.readouterr().err
    lithe.write_text("#!/bin/sh\necho 'lithe tune shield -- COMMAND'\n")
    monkeypatch.delenv("LITHE_BENCH_CORES", raising=False)
    assert run.shielded(["--shield", "--short"])[1:4] == ["tune", "shield", "--"]
    monkeypatch.setenv("LITHE_BENCH_CORES", "3,1")
    for usable, cores in (({1, 3}, "3"), ({0, 1, 2, 3}, "1,3")):  # the Transport has a core of its own
        monkeypatch.setattr(run.os, "sched_getaffinity", lambda _, usable=usable: usable)
        assert run.shielded(["--shield", "--short"])[1:6] == ["tune", "shield", "--cores", cores, "--"]
    for wrong in ("1", "1,x", "2,2", "1,2,3"):
        monkeypatch.setenv("LITHE_BENCH_CORES", wrong)
        with pytest.raises(run.report.Unmeasured, match="two different cores"):
            run.shielded(["--shield"])


@pytest.mark.parametrize(("known", "apart"), [(True, True), (None, True), (False, False)])
def test_interrupts_may_be_apart_unless_the_kernel_says_no(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, known: bool | None, apart: bool
) -> None:
    run, asked = module("run", monkeypatch), []

    def trace(core: int, *, apart: bool) -> None:
        asked.append((core, apart))
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "accounting", lambda: {"machine_irq_time_accounting": known})
    monkeypatch.setattr(run, "Trace", trace)
    bench = run.Bench.__new__(run.Bench)
    bench.spine, bench.told = 3, {}
    with pytest.raises(KeyboardInterrupt):
        bench.run()
    assert asked == [(3, apart)] and bench.told == {"machine_irq_time_accounting": known}


@pytest.mark.parametrize(
    ("cores", "free", "shielded"),
    [([0, 1], [0], "0"), ([0, 1, 2], [0], "0"), ([0, 1, 2, 3], [0, 3], "0,3")],  # Spine 1, its partner the next
)
def test_loads_stay_on_the_cores_that_a_robot_leaves_to_others(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cores: list[int], free: list[int], shielded: str
) -> None:
    run = module("run", monkeypatch)
    partner = 2 if len(cores) > 2 else 0
    monkeypatch.setattr(run.report, "cores", lambda: {"machine_spine_core": 1, "machine_partner_core": partner})
    monkeypatch.setattr(run.os, "sched_getaffinity", lambda _: set(cores))
    monkeypatch.setattr(run.os, "sched_setaffinity", lambda _, given: moved.append(sorted(given)))
    monkeypatch.setattr(run, "shield_is_up", lambda: True)
    monkeypatch.setenv(run.SHIELDED, "1")
    moved: list[list[int]] = []
    bench = run.Bench(run.plan_of(run.options(["--short"])), tmp_path)
    assert (bench.load_cores, moved, bench.brain) == (shielded, [free], free[-1])
    (sprawl,) = run.loads.load_of("numpy", bench.load_cores, "all", bench.brain, tmp_path, 1.0).commands
    assert sprawl[-1] == str(free[-1]), "on the Brain's core"
    monkeypatch.delenv(run.SHIELDED)
    assert run.Bench(run.plan_of(run.options(["--short"])), tmp_path).load_cores == ",".join(map(str, cores))


def test_a_run_is_shielded_only_while_the_shields_journal_is_locked(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, journal = module("run", monkeypatch), tmp_path / "shield.journal"
    monkeypatch.setattr(run, "SHIELD_JOURNAL", journal)
    cores = {"machine_spine_core": 0, "machine_partner_core": 1}
    monkeypatch.setattr(run.report, "cores", lambda: cores)
    monkeypatch.setattr(run.os, "sched_setaffinity", lambda *_: None)
    monkeypatch.setenv(run.SHIELDED, "1")
    plan = run.plan_of(run.options(["--short"]))
    assert run.Bench(plan, tmp_path).told["shielded"] is False, "no journal"
    with journal.open("wb") as held:
        assert run.Bench(plan, tmp_path).told["shielded"] is False, "left by a killed process"
        assert "no shield is up" in capsys.readouterr().err
        fcntl.flock(held, fcntl.LOCK_EX)
        assert run.Bench(plan, tmp_path).told["shielded"] is True


def test_a_stopped_run_leaves_no_result_that_looks_like_its_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    run = module("run", monkeypatch)
    for name in run.RESULTS:
        (tmp_path / name).write_text("holds")
    plan = run.plan_of(run.options(["--short"]))
    monkeypatch.setattr(run.report, "cores", dict)
    with pytest.raises(run.report.Unmeasured):
        run.measure(plan, tmp_path)
    assert all((tmp_path / name).exists() for name in run.RESULTS), "nothing can be measured here: nothing is renamed"
    monkeypatch.setattr(run.report, "cores", lambda: {"machine_spine_core": 0, "machine_partner_core": 1})
    monkeypatch.setattr(run.os, "sched_setaffinity", lambda *_: None)

    def stopped(_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(run.Bench, "run", stopped)
    with pytest.raises(KeyboardInterrupt):
        run.measure(plan, tmp_path)
    for name in run.RESULTS:
        assert not (tmp_path / name).exists() and (tmp_path / f"{name}.previous").read_text() == "holds"


def test_the_second_robot_keeps_off_the_measured_core(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    loads, storm = module("loads", monkeypatch), module("storm", monkeypatch)
    monkeypatch.setenv("LITHE_BENCH_CORES", "6,7")
    with loads.running(loads.Load("", (("sh", "-c", "env; echo all told"),), ready="all told"), tmp_path / "log"):
        assert "LITHE_BENCH_CORES" not in (tmp_path / "log").read_text()
    asked: dict[str, str] = {}

    @contextlib.contextmanager
    def running(_: Path, **changes: str) -> Iterator[None]:
        asked.update(changes)
        yield None

    monkeypatch.setattr(storm, "running", running)
    monkeypatch.setattr(storm.os, "sched_getaffinity", lambda _: {7})
    storm.main(tmp_path / "storm", -1.0)
    assert [asked[f"cpu_{name}"] for name in ("spine", "transport", "brain", "housekeeping")] == ["7"] * 4


def children_of(group: int) -> int:
    """Processes in a process group that are not dead."""
    found = subprocess.run(["ps", "-eo", "pgid=,stat="], capture_output=True, text=True, check=True).stdout
    return sum(line.split()[0] == str(group) and "Z" not in line.split()[1] for line in found.splitlines())


@pytest.mark.parametrize("moved", [False, True])
def test_a_program_that_nobody_pins_is_seen_where_it_runs(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, moved: bool
) -> None:
    """It lands on the Spine's core, unless something moved it off, as a shield does; whatever the bench pins."""
    outsider, cores = module("outsider", monkeypatch), sorted(os.sched_getaffinity(0))
    if len(cores) < 2:
        pytest.skip("needs two cores")
    spine, told = cores[-1], dict[str, Any]()
    with outsider.beside(True) as pid:
        for task in os.listdir(f"/proc/{pid}/task") if moved else []:
            os.sched_setaffinity(int(task), set(cores[:-1]))
        try:
            os.sched_setaffinity(0, {cores[0]})  # as the bench does
            with outsider.running(pid, spine, told), outsider.beside(True) as second:
                assert second is None, "one of them"
                time.sleep(2.0)
        finally:
            os.sched_setaffinity(0, set(cores))
    assert told["rogue_threads"] >= len(cores) and told["rogue_looks"] > 0 and not told["rogue_ended"]
    assert (str(spine) in told["rogue_ran_on"].split(",")) is not moved
    assert (told["rogue_share_on_spine_core"] > 0) is not moved
    assert not outsider.fields(pid), "it has ended"


@pytest.mark.parametrize("name", ["stress", "numpy", "compile"])
def test_a_load_and_all_it_started_end_with_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str) -> None:
    loads = module("loads", monkeypatch)
    cores = ",".join(map(str, sorted(os.sched_getaffinity(0))))
    load = loads.load_of(name, cores, cores, min(os.sched_getaffinity(0)), tmp_path, 60.0)
    with pytest.raises(KeyboardInterrupt), loads.running(load, tmp_path / "log") as started:
        end = time.monotonic() + 30
        while not all(children_of(process.pid) for process in started) and time.monotonic() < end:
            time.sleep(0.05)
        assert started and not loads.ended_early(started), (tmp_path / "log").read_text()
        raise KeyboardInterrupt
    assert all(process.poll() is not None for process in started)
    end = time.monotonic() + 30  # what was killed is gone when it has had the processor once more
    while any(children_of(process.pid) for process in started) and time.monotonic() < end:
        time.sleep(0.05)
    assert not any(children_of(process.pid) for process in started)


@pytest.mark.alone
@pytest.mark.long
def test_a_short_run_from_end_to_end(tmp_path: Path) -> None:
    """No figure is judged here: the machine that runs tests is busy with others."""
    need("lithe", "lithe-spine-sim", "lawd", "lithe-sim", "lithe-trial")
    binaries = Path(os.environ.get("LITHE_BIN_DIR", ROOT / "build/release/bin"))
    if not all((binaries / name).exists() for name in ("bench_isolation", "bench_plain_loop")):
        pytest.skip("bench_isolation is not built: make bench-isolation")
    words = [sys.executable, "-m", "bench.isolation", "--short", "--out", str(tmp_path)]
    env = os.environ | {"PYTHONPATH": f"{ROOT}/brain"}
    done = subprocess.run(words, check=False, cwd=ROOT, env=env, capture_output=True, text=True, timeout=400)
    assert done.returncode == 1, done.stdout + done.stderr
    told = json.loads((tmp_path / "isolation.json").read_text())
    assert not any(isinstance(value, dict | list) for value in told.values()), "flat"
    assert told["verdict"] == "INCONCLUSIVE" and "cycles" in told["reason"]
    for name in ("stress", "numpy", "compile", "swap", "idle"):
        assert told[f"cycles_{name}"] >= 900 and told[f"handoff_{name}_p50_us"] > 0, name
        assert told[f"r999_plain_loop_{name}"] > 0 and not told[f"load_ended_{name}"], name
    assert told["rig_offers"] >= 10 and told["second_robot_swaps"] >= 1, "in the measured rounds"
    programs = ("floor", "lithe", "plain_loop")
    keys = {f"{program}_stress_over_{limit_us}us" for program in programs for limit_us in (1, 5, 20, 100)}
    keys |= {f"r999_floor_{name}" for name in ("stress", "numpy", "swap", "compile", "idle")}
    keys |= {"machine_irq_time_accounting", "machine_steal_accounting", "untraced_blocks", "missed_deadlines_idle_ours"}
    keys |= {"r999_cyclictest_stress", "r999_plain_loop_numpy", "steal_share", "steal_share_kernel_stress"}
    assert keys <= told.keys(), keys - told.keys()
    assert told["rogue_looks"] > 0, "the program that nobody pins ran"
    assert told["control_over_floor"] is not None, "the control was measured"
    assert (tmp_path / "isolation.html").stat().st_size > 50_000
    assert not (tmp_path / "isolation/records").exists()
