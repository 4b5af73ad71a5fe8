# SPDX-License-Identifier: Apache-2.0
"""LITHE's own side of `make bench-swap`: a robot that follows a sine while its laws are replaced."""

from __future__ import annotations

import math
import os
import threading
import time
import tomllib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import lithe
import numpy as np
import numpy.typing as npt
from lithe._wire import Mode
from lithe.demo.evidence import made_to_wait
from lithe.demo.losses import Releases, releases
from lithe.errors import Refused
from lithe.programs import ROOT
from lithe.shm import SpineView

from bench.swap_host import interrupts, memory_kb, minor_faults
from bench.swap_stats import AFTER_NS, Figures, Round

CENTRE_RAD, AMPLITUDE_RAD, FREQUENCY_HZ = 0.6, 0.8, 0.5
WIDE_NM_S = "10000.0"  # a slew bound that cuts no step: what leaves is what the law, blended after a swap, asked for
HORIZON_NS, POINTS = 60_000_000, 16  # a plan reaches almost a second ahead: this process may be late
TICK = np.dtype(
    [("tick", "<i8"), ("release_ns", "<i8"), ("release_jitter_ns", "<i8"), ("missed_releases", "<i8"),
     ("output_late_ns", "<i8"), ("torque_nm", "<f8"), ("active", "?"), ("law_id", "<i8"), ("flags", "<i8"),
     ("position_rad", "<f8"), ("setpoint_position_rad", "<f8")]
)  # fmt: skip


def robot_file(folder: Path, **changes: str) -> Path:
    """robots/arm.toml with some of its values replaced, and patient with a machine that stalls."""
    # An arm that a stall has sent past its limit could never be armed again: nobody is there to bring it back.
    patience = {
        "late_ticks_to_stop": "300",
        "watchdog_s": "1.0",
        "stale_after_s": "1.0",
        "position_overrun_rad": "1000.0",
        "velocity_overrun": "10.0",
        "ideal": "true",  # what is measured is the swap
    }
    law = {"law": f'"{ROOT}/laws/pd.cpp"'}
    lines = (ROOT / "robots/arm.toml").read_text(encoding="utf-8").splitlines()
    for key, value in {**patience, **law, **changes}.items():
        at = [i for i, line in enumerate(lines) if line.split("=")[0].strip() == key]
        if len(at) != 1:
            raise RuntimeError(f"robots/arm.toml no longer has one line '{key} = ...'")
        lines[at[0]] = f"{key} = {value}"
    path = folder / "arm.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def shipped_slew_bound_nm() -> float:
    """The largest step from one tick to the next that the guard of robots/arm.toml lets through."""
    robot = tomllib.loads((ROOT / "robots/arm.toml").read_text(encoding="utf-8"))
    joint = {**robot.get("defaults", {}).get("joint", {}), **robot["joint"][0]}
    return float(joint["torque_slew_nm_s"]) / float(robot["rate_hz"])


def sine_rad(t_ns: int, centre_rad: float, amplitude_rad: float, frequency_hz: float) -> float:
    """The setpoint."""
    return centre_rad + amplitude_rad * math.sin(2 * math.pi * frequency_hz * t_ns * 1e-9)


WAKE_S = 600.0


def wake(robot: lithe.Robot) -> None:
    """Arms a robot that has stopped, because the machine stalled for longer than even a patient one bears."""
    end_s = time.monotonic() + WAKE_S
    while (mode := robot.status()["mode"]) != "active":
        try:
            if mode in ("safe_stop", "estop"):
                robot.reset()
            robot.arm()
        except lithe.Refused:  # the stall may last: nothing is fresh yet, or it has stopped once more
            if time.monotonic() > end_s:
                raise
            time.sleep(0.1)


class Background:
    """A thread that calls something again and again until stop()."""

    def __init__(self, call: Callable[[], None], every_s: float) -> None:
        self._call, self._every_s = call, every_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(self._every_s):
            self._call()

    def stop(self) -> None:
        """Returns when the last call is over."""
        self._stop.set()
        self._thread.join()


class TickLog:
    """Every tick of a run, by the few figures that are asked of it."""

    def __init__(self, robot: str) -> None:
        self._cursor = SpineView(robot).telemetry()
        self._parts: list[npt.NDArray[Any]] = []

    def look(self) -> None:
        """Takes what has come; the ring holds four seconds."""
        records = self._cursor.drain()
        part = np.zeros(len(records), TICK)
        for name in ("tick", "release_ns", "release_jitter_ns", "missed_releases", "law_id", "flags"):
            part[name] = records[name]
        for name in ("position_rad", "setpoint_position_rad"):
            part[name] = records[name][:, 0]
        part["torque_nm"] = records["command_torque_nm"][:, 0]
        part["output_late_ns"] = part["release_jitter_ns"] + records["handoff_ns"]
        part["active"] = records["mode"] == Mode.active
        self._parts.append(part)

    @property
    def lost(self) -> int:
        """Records that were overwritten before they were read."""
        return self._cursor.lost

    def ticks(self) -> npt.NDArray[Any]:
        """All of them so far."""
        return np.concatenate(self._parts)


@dataclass
class Tally:
    """Interrupts and page faults while swapping, and while not."""

    counts: npt.NDArray[np.float64] = field(default_factory=lambda: np.zeros(5))  # INTERRUPTS, minor faults
    seconds: float = 0.0


class Subject:
    """A running robot, and all that is seen of it."""

    def __init__(
        self, robot: lithe.Robot, sources: list[Path], looks: Callable[[], None] = lambda: None, variants: int = 1
    ) -> None:
        self.robot, info = robot, robot.spine.info
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
        self.swapping, self.resting = Tally(), Tally()
        self.log = TickLog(robot.name)
        self._asked = 0
        self._looks = looks
        self._threads = [Background(self._plan, 0.1), Background(self._look, 0.025)]
        keep_off(robot)
        for _ in self.laws:  # compiled now; from here on the cache answers
            self._swap()
        self.records = []
        self.memory_seen = {"start": self._memory()}
        self.waits_before = made_to_wait(self.pid, self.tid)

    def _plan(self) -> None:
        now_ns = time.monotonic_ns()
        times = [now_ns + HORIZON_NS * k for k in range(POINTS)]
        self.robot.publish(times, [sine_rad(t, CENTRE_RAD, AMPLITUDE_RAD, FREQUENCY_HZ) for t in times])

    def _look(self) -> None:
        self.log.look()
        self._looks()

    def _swap(self) -> None:
        name, source = self.laws[self._asked % len(self.laws)]
        self._asked += 1
        asked_ns = time.monotonic_ns()
        try:
            record = self.robot.swap(source, name=name)
        except Refused as refusal:
            self.refused[refusal.code] += 1
            return
        self.records.append({**record, "asked_ns": asked_ns, "answered_ns": time.monotonic_ns()})

    def _counts(self) -> npt.NDArray[np.float64]:
        return np.append(interrupts(self.cpu), minor_faults(self.pid, self.tid))

    def group(self, swaps: int, pause_s: float) -> None:
        """So many swaps one right after the other, then none for a while."""
        wake(self.robot)
        from_ns, before = time.monotonic_ns(), self._counts()
        done = len(self.records)
        for _ in range(swaps):
            self._swap()
        time.sleep(AFTER_NS * 1e-9)
        between_ns, between = time.monotonic_ns(), self._counts()
        time.sleep(pause_s)
        until_ns, after = time.monotonic_ns(), self._counts()
        self.swapping.counts += between - before
        self.swapping.seconds += (between_ns - from_ns) * 1e-9
        self.resting.counts += after - between
        self.resting.seconds += (until_ns - between_ns) * 1e-9
        self.rounds.append(Round((from_ns, between_ns), (between_ns, until_ns), len(self.records) - done))

    def per_swap(self) -> Figures:
        """Interrupts on the Spine's core and page faults of its thread, less what comes without swaps."""
        swaps = max(len(self.records), 1)
        expected = self.resting.counts * (self.swapping.seconds / max(self.resting.seconds, 1e-9))
        names = ("interrupts_tlb", "interrupts_cal", "interrupts_res", "interrupts_loc", "page_faults")
        raw, excess = self.swapping.counts / swaps, (self.swapping.counts - expected) / swaps
        told = {f"{name}_per_swap": float(value) for name, value in zip(names, excess, strict=True)}
        return told | {f"{name}_per_swap_raw": float(value) for name, value in zip(names, raw, strict=True)}

    def _memory(self) -> dict[str, int]:
        sizes = {name: memory_kb(pid) for name, pid in self.processes.items()}
        return {f"{name}_{kind}": size for name, kinds in sizes.items() for kind, size in kinds.items()}

    def note_memory(self, when: str) -> None:
        """Of all three processes; the first note was taken when the laws were compiled."""
        self.memory_seen[when] = self._memory()

    def memory(self) -> Figures:
        """All that was noted, and the arena."""
        told: Figures = {f"{key}_{when}": kb for when, seen in self.memory_seen.items() for key, kb in seen.items()}
        info = self.robot.spine.info
        told["arena_kb"] = int(info["arena_slots"]) * int(info["arena_slot_bytes"]) // 1024
        told["arena_slots_in_use"] = sum(int(law["slot"]) != 0 for law in self.robot.spine.laws())
        told["arena_slots"] = int(info["arena_slots"])
        return told

    def preempted_share(self) -> float:
        """Of the ticks: how often another thread got the Spine's core."""
        ticks = max(len(self.log.ticks()), 1)
        return (made_to_wait(self.pid, self.tid) - self.waits_before) / ticks

    def releases(self) -> Releases:
        """All of them."""
        return releases(self.log.ticks(), round(1e9 / float(self.robot.spine.info["rate_hz"])))

    def stop(self) -> None:
        """Ends the threads; the robot runs on."""
        for thread in self._threads:
            thread.stop()
        self.log.look()


def keep_off(robot: lithe.Robot) -> None:
    """All threads of this process to the housekeeping core: the Brain's is the peers'."""
    info = robot.spine.info
    mine = {int(info["cpu_housekeeping"])}
    for task in Path("/proc/self/task").iterdir():
        os.sched_setaffinity(int(task.name), mine)
