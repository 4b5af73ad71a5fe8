# SPDX-License-Identifier: Apache-2.0
"""The programs that `make bench-isolation` compares, each asked for one block at a time."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from lithe.demo.evidence import STEAL_STEP_NS, stolen_ticks
from lithe.demo.processes import LEAVE_WITH_US
from lithe.errors import LitheError
from lithe.programs import ROOT, binary

from bench import report
from bench.asked import Asked
from bench.isolation.attribution import Trace
from bench.isolation.figures import CYCLICTEST, RECORD, Records, peer_records
from bench.isolation.verdict import MISSING

START_S = 30.0
PATIENCE = 10.0  # times the length of a block: then the program is ended
MOTEUS = "moteus==1.0.0"
DRIVE = 1


def ask(program: Asked, request: str, seconds: float) -> Any:
    """The answer; a program that gives none is ended, which is report.Unmeasured."""
    end = threading.Timer(START_S + PATIENCE * seconds, program.process.kill)
    end.start()
    try:
        return program.ask(request)
    except BrokenPipeError:
        raise report.Unmeasured(f"{program.name} has ended") from None
    finally:
        end.cancel()


class Subject(Asked):
    """bench_isolation: the floor, LITHE, the control, and cyclictest on the same core."""

    def __init__(self, cores: str, file: Path, trace: Trace) -> None:
        self._file, self._read, self._trace = file, 0, trace
        words = ["taskset", "-c", cores, *report.program("isolation"), str(file)]
        super().__init__("bench_isolation", words, session=True)

    def run(self, verb: str, count: int, seconds: float) -> Records:
        """The records of one request."""
        self._trace.read()  # what came before
        answer = ask(self, f"{verb} {count}", seconds)
        records = np.fromfile(self._file, RECORD, answer["records"], offset=self._read * RECORD.itemsize)
        self._trace.attribute(records, self.process.pid)
        self._read += len(records)
        return records

    def offers(self, on: bool) -> int:
        """Starts or stops the swaps; how many laws were offered so far. Each was taken before the next could be."""
        return int(ask(self, f"swaps {int(on)}", 1)["offers"])


def steal_ns(cores: list[int]) -> int:
    """What the hypervisor has taken from these cores since boot."""
    return sum(stolen_ticks(core)[0] for core in cores) * STEAL_STEP_NS


@contextlib.contextmanager
def drive(folder: Path) -> Iterator[Path]:
    """A simulated moteus drive at a pseudo terminal; its path."""
    try:
        words = [*LEAVE_WITH_US, str(binary("lithe")), "sim", str(ROOT / "robots/arm.toml"), "--link", str(folder)]
    except LitheError as why:
        raise report.Unmeasured(str(why)) from None
    with (folder.parent / "sim.log").open("wb") as log:
        sim = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True)
    try:
        end = time.monotonic() + START_S
        while not (folder / "can0").exists():
            if sim.poll() is not None or time.monotonic() > end:
                raise report.Unmeasured(f"`lithe sim` gave no terminal: {log.name}")
            time.sleep(0.05)
        yield folder / "can0"
    finally:
        sim.terminate()
        try:
            sim.wait(START_S)
        except subprocess.TimeoutExpired:
            sim.kill()
            sim.wait()


class Peers:
    """The programs beside LITHE. `absent`: those that are not measured, and why; `records` drops one that fails."""

    def __init__(self, subject: Subject, cores: list[int], spine_core: int, folder: Path) -> None:
        self._subject, self._cores, self._spine_core, self._folder = subject, cores, spine_core, folder
        self._ends = contextlib.ExitStack()
        self._running: dict[str, Asked] = {}
        self.absent: dict[str, str] = {}
        for name, start in (("plain_loop", self._plain_loop), ("moteus_loop", self._moteus_loop)):
            try:
                self._running[name] = self._ends.enter_context(start())
            except (report.Unmeasured, OSError) as why:
                self.absent[name] = str(why)
        if not shutil.which("cyclictest"):
            self.absent["cyclictest"] = f"cyclictest is missing: {MISSING}"

    def close(self) -> None:
        """Ends them."""
        self._ends.close()

    def _unpinned(self, name: str, words: list[str], env: dict[str, str] | None = None) -> Asked:
        return Asked(name, ["taskset", "-c", ",".join(map(str, self._cores)), *words], env, session=True)

    def _plain_loop(self) -> Asked:
        program = report.program("plain_loop")
        if not Path(program[0]).exists():
            raise report.Unmeasured(f"{program[0]} is missing; `make bench-isolation` builds it")
        return self._unpinned("plain_loop", list(program))

    def _moteus_loop(self) -> Asked:
        got = subprocess.run(
            [sys.executable, "tools/pypi.py", MOTEUS], cwd=ROOT, check=False, capture_output=True, text=True
        )
        if got.returncode != 0:
            raise report.Unmeasured(got.stderr.strip())
        path = self._ends.enter_context(drive(self._folder / "buses"))
        words = [sys.executable, str(ROOT / "bench/isolation/moteus_loop.py"), str(path), str(DRIVE)]
        return self._unpinned("moteus_loop", words, os.environ | {"PYTHONPATH": got.stdout.strip()})

    def records(self, name: str, seconds: float) -> Records | None:
        """One block of a peer, at 1 kHz; None when it is absent."""
        if name in self.absent:
            return None
        cores = [self._spine_core] if name == "cyclictest" else self._cores
        before_ns = steal_ns(cores)
        try:
            if name == "cyclictest":
                records = self._subject.run("cyclictest", max(1, round(seconds)), seconds)
                late_ns = records["late_ns"][records["program"] == CYCLICTEST]
                if not len(late_ns):
                    raise report.Unmeasured("cyclictest gave no figures; what it said is above")
            else:
                late_ns = np.array(ask(self._running[name], str(round(1000 * seconds)), seconds), np.int64)
        except report.Unmeasured as why:
            if name == "cyclictest" and self._subject.process.poll() is not None:
                raise
            self.absent[name] = str(why)
            return None
        grown_ns = steal_ns(cores) - before_ns
        return peer_records(late_ns, grown_ns + (STEAL_STEP_NS if grown_ns else 0))  # the count is rounded down
