# SPDX-License-Identifier: Apache-2.0
"""The LITHE part of `make bench-swap`: a robot that follows a sine while its laws are swapped."""

from __future__ import annotations

import math
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import lithe
import numpy as np
import numpy.typing as npt
from lithe._wire import Mode
from lithe.demo.evidence import made_to_wait
from lithe.demo.losses import Releases, releases
from lithe.demo.processes import Stage
from lithe.errors import Refused
from lithe.files import robot_table
from lithe.heartbeat import Repeat
from lithe.programs import ROOT
from lithe.shm import SpineView

from bench.swap.host import COUNTED, interrupts, memory_kb, minor_faults
from bench.swap.stats import AFTER_NS, Round
from bench.tables import Figures

SINE = {"centre_rad": 0.6, "amplitude_rad": 0.8, "frequency_hz": 0.5}
WIDE_NM_S = "10000.0"  # a slew bound that limits no step: the output is what the law commands, blended after a swap
HORIZON_NS, POINTS = 60_000_000, 16  # a plan covers almost a second, because this process may be late
TICK = np.dtype(
    [("tick", "<i8"), ("release_ns", "<i8"), ("release_jitter_ns", "<i8"), ("missed_releases", "<i8"),
     ("output_late_ns", "<i8"), ("torque_nm", "<f8"), ("active", "?"), ("law_id", "<i8"), ("flags", "<i8"),
     ("position_rad", "<f8"), ("setpoint_position_rad", "<f8")]
)  # fmt: skip


def robot_file(folder: Path, **changes: str) -> Path:
    """robots/arm.toml with some of its values replaced, and with long time-outs for a machine with stalls."""
    # An arm that passed its limit in a stall could not be armed again, because nobody recovers it.
    patience = {
        "late_ticks_to_stop": "300",
        "watchdog_s": "1.0",
        "stale_after_s": "1.0",
        "position_overrun_rad": "1000.0",
        "velocity_overrun": "10.0",
        "ideal": "true",  # only the effect of the swap is measured
    }
    law = {"law": f'"{ROOT}/laws/pd.cpp"'}
    lines = (ROOT / "robots/arm.toml").read_text(encoding="utf-8").splitlines()
    spine, _, partner = os.environ.get("LITHE_BENCH_CORES", "").partition(",")
    cores = {"cpu_spine": spine, "cpu_brain": partner, "cpu_housekeeping": partner} if spine else {}
    for key, value in {**patience, **law, **cores, **changes}.items():
        at = [i for i, line in enumerate(lines) if line.split("=")[0].strip() == key]
        if len(at) != 1:
            raise RuntimeError(f"robots/arm.toml no longer has one line '{key} = ...'")
        lines[at[0]] = f"{key} = {value}"
    path = folder / "arm.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def shipped_slew_bound_nm() -> float:
    """The largest step from one tick to the next that the guard of robots/arm.toml permits."""
    robot = robot_table((ROOT / "robots/arm.toml").read_text(encoding="utf-8"))
    return float(robot["joint"][0]["torque_slew_nm_s"]) / float(robot["rate_hz"])


REFUSED_LAST = ROOT / "bench/swap/laws/refused_last.cpp"
WAKE_S = 600.0


@contextmanager
def running(folder: Path, **changes: str) -> Iterator[lithe.Robot]:
    """`lithe run` of a desk arm with long time-outs, and a connected Brain."""
    with Stage(robot_file(folder, **changes), folder / "run.log"), lithe.connect("arm") as robot:
        yield robot


def wake(robot: lithe.Robot) -> None:
    """Arms a robot that has stopped, because the machine stalled for longer than its time-outs."""
    end_s = time.monotonic() + WAKE_S
    while (mode := robot.status()["mode"]) != "active":
        try:
            if mode in ("safe_stop", "estop"):
                robot.reset()
            robot.arm()
        except lithe.Refused:  # the stall may continue: no fresh sample yet, or the robot has stopped again
            if time.monotonic() > end_s:
                raise
            time.sleep(0.1)


class TickLog:
    """The fields of every tick of a run that the bench needs."""

    def __init__(self, robot: str) -> None:
        self._cursor = SpineView(robot).telemetry()
        self._parts: list[npt.NDArray[Any]] = []

    def look(self) -> None:
        """Takes the new records; the ring holds four seconds."""
        records = self._cursor.drain()
        part = np.zeros(len(records), TICK)
        for name in ("tick", "release_ns", "release_jitter_ns", "missed_releases", "law_id", "flags"):
            part[name] = records[name]
        for name in ("position_rad", "setpoint_position_rad"):
            part[name] = records[name][:, 0]
        part["torque_nm"] = records["command_torque_nm"][:, 0]
        part["output_late_ns"] = np.add(part["release_jitter_ns"], records["handoff_ns"])
        part["active"] = records["mode"] == Mode.active
        self._parts.append(part)

    @property
    def lost(self) -> int:
        """Records that were overwritten before they were read."""
        return self._cursor.lost

    def ticks(self) -> npt.NDArray[Any]:
        """All of them so far."""
        return np.concatenate(self._parts)


class Mover:
    """A robot that follows a sine, and its ticks in `log`."""

    def __init__(self, robot: lithe.Robot, sine: dict[str, float], looks: Sequence[Callable[[], None]] = ()) -> None:
        """`looks` are called as often as the log is filled."""
        self.robot, self.log = robot, TickLog(robot.name)
        self._sine, self._looks = sine, (self.log.look, *looks)
        self._threads = [Repeat(self._plan, 0.1), Repeat(self._look, 0.025)]

    def _plan(self) -> None:
        now_ns = time.monotonic_ns()
        times = [now_ns + HORIZON_NS * k for k in range(POINTS)]
        omega = 2e-9 * math.pi * self._sine["frequency_hz"]
        centre_rad, amplitude_rad = self._sine["centre_rad"], self._sine["amplitude_rad"]
        self.robot.publish(times, [centre_rad + amplitude_rad * math.sin(omega * t) for t in times])

    def _look(self) -> None:
        for look in self._looks:
            look()

    def stop(self) -> None:
        """Ends the threads; the robot continues."""
        for thread in self._threads:
            thread.stop()
        self.log.look()


@dataclass
class Tally:
    """Interrupts and page faults, and the time in which they were counted."""

    counts: npt.NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(COUNTED) + 1))  # and minor faults
    seconds: float = 0.0


class Subject(Mover):
    """A running robot whose laws are swapped, and all that is recorded about it."""

    def __init__(
        self, robot: lithe.Robot, sources: list[Path], looks: Sequence[Callable[[], None]] = (), variants: int = 1
    ) -> None:
        super().__init__(robot, SINE, looks)
        info = robot.spine.info
        self.cpu, self.tid = int(info["cpu_spine"]), int(info["tid_spine"])
        self.pid = int(robot.spine.mapping.header().writer_pid)
        status = robot.status()
        self.loader = status["loader"]
        self.processes = {"spine": self.pid, "supervisor": status["supervisor_pid"], "lawd": status["lawd_pid"]}
        texts = [(source.name, source.read_text(encoding="utf-8")) for source in sources]
        self.laws = [(name, f"{text}// {i}\n" if i else text) for i in range(variants) for name, text in texts]
        self.rounds: list[Round] = []
        self.records: list[dict[str, Any]] = []
        self.refused: Counter[str] = Counter()
        self.trials = 0  # without a swap
        self.trials_wrong: Counter[str] = Counter()  # those that did not end in the trial, by their end
        self.load_us: list[float] = []
        self.swapping, self.resting = Tally(), Tally()
        self._asked = 0
        keep_off(robot)
        for _ in self.laws:  # compiled now; from here on they come from the cache
            self._swap()
        self._try()
        self.records, self.trials = [], 0
        self._events = robot.events()["cursor"]
        self.memory_seen = {"start": self._memory()}
        self.waits_before = made_to_wait(self.pid, self.tid)

    def _swap(self) -> None:
        name, source = self.laws[self._asked % len(self.laws)]
        self._asked += 1
        asked_ns = time.monotonic_ns()
        try:
            record = self.robot.swap(source, name=name)
        except Refused as refusal:
            self.refused[refusal.code] += 1
            return
        self.records.append({**record, "asked_ns": asked_ns})

    def _try(self) -> None:
        """All that a swap does beside the Spine; then the trial refuses the law."""
        self.trials += 1
        try:
            self.robot.swap(REFUSED_LAST.read_text(encoding="utf-8"), name=REFUSED_LAST.name)
            self.trials_wrong["committed"] += 1
        except Refused as refusal:
            if refusal.code != "trial_failed":
                self.trials_wrong[refusal.code] += 1

    def _counts(self) -> npt.NDArray[np.float64]:
        return np.append(interrupts(self.cpu), minor_faults(self.pid, self.tid))

    def group(self, swaps: int, pause_s: float) -> None:
        """This many swaps without a pause between them, half as many trials without a swap, then a pause."""
        wake(self.robot)
        from_ns, before = time.monotonic_ns(), self._counts()
        done = len(self.records)
        for _ in range(swaps):
            self._swap()
        time.sleep(AFTER_NS * 1e-9)
        between_ns, between = time.monotonic_ns(), self._counts()
        for _ in range((swaps + 1) // 2):
            self._try()
        time.sleep(AFTER_NS * 1e-9)
        tried_ns, tried = time.monotonic_ns(), self._counts()
        time.sleep(pause_s)
        until_ns, after = time.monotonic_ns(), self._counts()
        self.swapping.counts += between - before
        self.swapping.seconds += (between_ns - from_ns) * 1e-9
        self.resting.counts += after - tried
        self.resting.seconds += (until_ns - tried_ns) * 1e-9
        swapping, trying, resting = pairwise((from_ns, between_ns, tried_ns, until_ns))
        self.rounds.append(Round(swapping, resting, len(self.records) - done, trying))
        told = self.robot.events(self._events)
        self._events = told["cursor"]
        self.load_us += [1e3 * event["value"] for event in told["events"] if event["kind"] == "law_staged"]

    def per_swap(self) -> Figures:
        """Interrupts on the Spine's core and page faults of its thread, minus those without swaps; time of loading."""
        swaps = max(len(self.records), 1)
        expected = self.resting.counts * (self.swapping.seconds / max(self.resting.seconds, 1e-9))
        names = (*COUNTED, "page_faults")
        raw, excess = self.swapping.counts / swaps, (self.swapping.counts - expected) / swaps
        told = {f"{name}_per_swap": float(value) for name, value in zip(names, excess, strict=True)}
        told |= {f"{name}_per_swap_raw": float(value) for name, value in zip(names, raw, strict=True)}
        return told | {"load_p50_us": float(np.median(self.load_us))} if self.load_us else told

    def _memory(self) -> dict[str, int]:
        sizes = {name: memory_kb(pid) for name, pid in self.processes.items()}
        return {f"{name}_{kind}": size for name, kinds in sizes.items() for kind, size in kinds.items()}

    def note_memory(self, when: str) -> None:
        """Records the memory of all three processes; the first record was made after the laws were compiled."""
        self.memory_seen[when] = self._memory()

    def memory(self) -> Figures:
        """All recorded sizes, and the arena."""
        told: Figures = {f"{key}_{when}": kb for when, seen in self.memory_seen.items() for key, kb in seen.items()}
        info = self.robot.spine.info
        told["arena_kb"] = int(info["arena_slots"]) * int(info["arena_slot_bytes"]) // 1024
        told["arena_slots_in_use"] = sum(int(law["slot"]) != 0 for law in self.robot.spine.laws())
        told["arena_slots"] = int(info["arena_slots"])
        return told

    def preempted_share(self) -> float:
        """How often another thread got the Spine's core, as a share of the ticks."""
        ticks = max(len(self.log.ticks()), 1)
        return (made_to_wait(self.pid, self.tid) - self.waits_before) / ticks

    def releases(self) -> Releases:
        """All releases."""
        return releases(self.log.ticks(), round(1e9 / float(self.robot.spine.info["rate_hz"])))


def keep_off(robot: lithe.Robot) -> None:
    """Moves all threads of this process to the housekeeping core: the peers use the Brain's."""
    info = robot.spine.info
    mine = {int(info["cpu_housekeeping"])}
    for task in Path("/proc/self/task").iterdir():
        os.sched_setaffinity(int(task.name), mine)
