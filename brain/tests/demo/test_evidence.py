# SPDX-License-Identifier: Apache-2.0
"""The kernel's counts tell a core that was taken away from a thread that is slow or stopped by itself."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import lithe
import numpy as np
import pytest
from lithe.demo import losses
from lithe.demo.evidence import STEAL_STEP_NS, Evidence, Thread, Watch, tally, threads_of
from lithe.demo.recorder import Recorder

MS = 1_000_000
SPINNING = "import os, sys\nos.sched_setaffinity(0, {int(sys.argv[1])})\nwhile True: pass"
CORE = max(os.sched_getaffinity(0))
MOST_S = 60.0


@pytest.fixture
def spin() -> Iterator[Callable[[int], int]]:
    """Starts a program that never rests, on one core; its pid."""
    started: list[subprocess.Popen[bytes]] = []

    def start(core: int = CORE) -> int:
        started.append(subprocess.Popen([sys.executable, "-c", SPINNING, str(core)]))
        return started[-1].pid

    yield start
    for process in started:
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.wait()


def state_of(pid: int) -> str:
    return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()[0]


def test_a_thread_that_is_stopped_has_no_excuse(spin: Callable[[int], int]) -> None:
    pid = spin(CORE)
    os.kill(pid, signal.SIGSTOP)
    until = time.monotonic() + MOST_S
    while state_of(pid) != "T" and time.monotonic() < until:
        time.sleep(0.001)
    watch = Watch([Thread(pid, pid, CORE)])
    time.sleep(0.2)
    watch.look()
    assert np.ptp(watch.evidence().waited_ns) == 0


def test_a_thread_that_shares_its_core_waits_and_it_is_seen(spin: Callable[[int], int]) -> None:
    pids = [spin(CORE) for _ in range(3)]
    watch, blind = Watch([Thread(pids[0], pids[0], CORE)]), Watch([Thread(pids[0], pids[0], CORE, alone=False)])
    until = time.monotonic() + MOST_S
    while np.ptp(watch.evidence().waited_ns) < 100 * MS and time.monotonic() < until:
        time.sleep(0.02)
        watch.look()
    blind.look()
    told = watch.evidence()
    assert np.ptp(told.waited_ns) >= 100 * MS and told.switches > 0
    assert np.ptp(blind.evidence().waited_ns) == 0, "it may have waited for a program of ours"


def test_evidence_counts_where_it_was_seen() -> None:
    at_ns = np.arange(0, 1000 * MS, 50 * MS)
    waited_ns = np.where(at_ns >= 500 * MS, 7 * MS, 0)
    stolen_ns = np.where(at_ns >= 800 * MS, 20 * MS, 0)
    told = Evidence(at_ns, waited_ns, stolen_ns)
    assert told.took_ns((0, 300 * MS)) == 0
    assert told.took_ns((440 * MS, 460 * MS)) == 7 * MS, "seen after the window"
    assert told.took_ns((700 * MS, 790 * MS)) == 20 * MS + STEAL_STEP_NS, "the kernel cuts off what is no whole step"
    made = losses.Releases(np.arange(0, 1000 * MS, MS), np.zeros(1000, np.int64), np.arange(1000) % 100 < 10)
    found = tally(made, losses.slices((0, 1000 * MS), 100 * MS), told, MS)
    assert (found["missed"], found["releases"]) == (100, 1000)
    assert found["machine"] == 7 + 10 and found["own"] == 100 - found["machine"]


def missed(recording: Recorder, period_ns: int) -> dict[str, float]:
    records = recording.finish()
    made = losses.with_missed_deadlines(losses.releases(records, period_ns), records)
    span = (int(records["release_ns"][0]), int(records["release_ns"][-1]) + 1)
    return tally(made, losses.slices(span, 1000 * MS), recording.evidence(), period_ns)


@pytest.mark.alone
def test_a_real_spine_that_is_starved_is_told_from_one_that_is_stopped(
    robot: lithe.Robot, spin: Callable[[int], int]
) -> None:
    info, pid = robot.spine.info, int(robot.spine.mapping.header().writer_pid)
    period_ns = round(1e9 / float(info["rate_hz"]))
    (tick, *_) = threads_of(info, pid)
    assert (tick.tid, tick.cpu) == (int(info["tid_spine"]), int(info["cpu_spine"]))
    if not tick.alone:
        pytest.skip("one core: the Spine shares it with the rest of LITHE, and nothing is evidence")
    recording = Recorder(robot.name)
    for _ in range(5):
        os.kill(pid, signal.SIGSTOP)
        time.sleep(0.2)
        os.kill(pid, signal.SIGCONT)
        time.sleep(0.1)
    stopped = missed(recording, period_ns)
    recording = Recorder(robot.name)
    hogs = [spin(tick.cpu) for _ in range(8)]
    starved: dict[str, float] = {"missed": 0, "machine": 0}
    until = time.monotonic() + MOST_S
    while starved["missed"] < 20 and time.monotonic() < until:
        time.sleep(3.0)
        found = missed(recording, period_ns)
        starved = {name: starved[name] + found[name] for name in starved}
        recording = Recorder(robot.name)
    for hog in hogs:
        os.kill(hog, signal.SIGSTOP)
    recording.finish()
    print(f"stopped: {stopped}; starved: {starved}")
    assert stopped["missed"] >= 800 and stopped["own"] > 0
    assert starved["missed"] >= 20, "eight programs on the core of the Spine cost it no tick"
    assert starved["machine"] > starved["missed"] / 2
