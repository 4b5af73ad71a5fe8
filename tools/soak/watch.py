# SPDX-License-Identifier: Apache-2.0
"""Looks at the robot all the time: telemetry and process from a thread, certificates and sizes after each action."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from lithe.certificates import verify
from lithe.heartbeat import Repeat

from . import growth
from .judge import Broken, Joints, Judge
from .rig import Rig

LOOK_S, SAMPLE_S, VERIFY_S = 0.05, 5.0, 60.0
WRITTEN_S = 20.0  # a certificate is written in a later turn of the supervisor, on a busy machine much later
NEWEST = 100
HELPERS = ("supervisor", "lawd", "trial")


class Book:
    """The certificates of one run of a Spine, by request and by law."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._of_request: dict[int, Path] = {}
        self._seen: set[Path] = set()
        self.count = 0

    def begin(self) -> None:
        """A new Spine counts its laws from 1: the certificates so far are not of its laws."""
        self.read()
        self._of_request.clear()

    def read(self) -> None:
        """Takes notice of new ones."""
        for path in sorted(set(self.folder.glob("*.json")) - self._seen):
            with contextlib.suppress(ValueError, OSError):  # it is being written
                self._of_request[int(json.loads(path.read_bytes())["request_id"])] = path
                self._seen.add(path)
        self.count = len(self._seen)

    def of_request(self, request_id: int) -> dict[str, Any]:
        """{} while there is none."""
        if request_id not in self._of_request:
            self.read()
        with contextlib.suppress(KeyError, ValueError, OSError):
            told: dict[str, Any] = json.loads(self._of_request[request_id].read_bytes())
            return told
        return {}

    def of_law(self, law_id: int) -> dict[str, Any] | None:
        """Among the newest: a law that runs is never old."""
        self.read()
        for request_id in sorted(self._of_request, reverse=True)[:NEWEST]:
            told = self.of_request(request_id)
            if told.get("law_id") == law_id:
                return told
        return None


class Watch:
    """Feeds the judge. The first thing that does not hold stays in `broken`."""

    def __init__(self, rig: Rig, judge: Judge) -> None:
        self.rig, self.judge = rig, judge
        self.book = Book(rig.swaps)
        self.series: dict[str, list[growth.Sample]] = defaultdict(list)
        self.broken: Broken | None = None
        self.records = self._lost = 0
        self.since_s = 0.0  # of a resumed soak: how long it ran before
        self._began_s = time.monotonic()
        self._ran: set[int] = set()  # laws seen in the telemetry of this Spine
        self._proven: set[int] = set()
        self._blind = False
        self._next_sample_s = self._next_verify_s = 0.0
        self._lock = threading.Lock()
        self._thread: Repeat | None = None
        self.book.begin()

    @property
    def lost(self) -> int:
        """Records that were overwritten before they were read."""
        return self._lost + self._cursor.lost

    def forget(self) -> None:
        """The Spine has ended on purpose; the next one, which begins after this, has other laws."""
        with self._lock:
            self._look()
            self.book.begin()
            self._ran, self._proven = set(), set()
            self._lost += self._cursor.lost

    def attach(self) -> None:
        """To the Spine that runs now: the first one, or a new one."""
        with self._lock:
            overrun_rad = self.rig.config.get("guard", {}).get("position_overrun_rad", 0.2)
            self._joints = Joints.of(self.rig.spine.info, float(overrun_rad))
            self._cursor = self.rig.spine.telemetry()
        if self._thread is None:
            self._thread = Repeat(self._guarded_look, LOOK_S)

    def _guarded_look(self) -> None:
        try:
            with self._lock:
                self._look()
        except Broken as broken:
            self.broken = self.broken or broken

    def _look(self) -> None:
        expected = self.rig.spine_pid
        records = self._cursor.drain()
        self.records += len(records)
        if expected:
            spine = self.rig.spine
            latest = spine.latest()
            pid = int(spine.mapping.header().writer_pid) if spine.mapping.is_current() else 0
            alive = bool(growth.of_process(pid))
            if expected == self.rig.spine_pid:  # it was not killed on purpose meanwhile
                tick = 0 if latest is None else int(latest["tick"])
                self.judge.alive(pid, expected, tick, time.monotonic(), alive)
        else:
            self.judge.alive(0, 0, 0, time.monotonic())
        self._ran |= set(np.unique(records["law_id"]).tolist()) - {0}
        self.judge.records(records, self._joints, self._blind)

    @contextlib.contextmanager
    def blind(self) -> Iterator[None]:
        """While a fault is injected into a bus, positions are not judged."""
        with self._lock:
            self._look()
            self._blind = True
        try:
            yield
        finally:
            with self._lock:
                self._look()
                self._blind = False

    def check(self, excused: bool = False) -> None:
        """After an action: what the thread has found, laws that ran, and from time to time sizes and the chain.

        `excused`: see Judge.in_force.
        """
        if self.broken:
            raise self.broken
        with self._lock:
            self._look()
            new = self._ran - self._proven
        for law_id in sorted(new):
            until = time.monotonic() + WRITTEN_S
            while (told := self.book.of_law(law_id)) is None and not excused and time.monotonic() < until:
                time.sleep(0.1)
            self.judge.in_force(law_id, told, excused)
            self._proven.add(law_id)
        now = time.monotonic()
        if now >= self._next_sample_s:
            self._next_sample_s = now + SAMPLE_S
            self.sample()
        if now >= self._next_verify_s:
            self._next_verify_s = now + VERIFY_S
            self.chain()

    def swap_answered(self, code: str, told: dict[str, Any]) -> None:
        """Compares the answer to a swap with its certificate."""
        answer = told if code == "ok" else told.get("swap", {})
        if "request_id" not in answer:
            return None  # it was refused before it got a certificate
        until = time.monotonic() + WRITTEN_S
        while True:
            certificate = self.book.of_request(int(answer["request_id"]))
            try:
                if not certificate:
                    raise Broken("certificates", f"swap {answer['request_id']} ({code}) has no certificate")
                return self.judge.verdict(code, answer, certificate)
            except Broken:
                if time.monotonic() > until:
                    raise
                time.sleep(0.1)

    def chain(self) -> None:
        """All certificates against their chain."""
        chain = verify(self.rig.swaps)
        self.judge.holds("certificates", chain.holds, lambda: str(chain.problems[:3]))

    def sample(self) -> None:
        """Memory, descriptors, segments, and the folder of certificates."""
        t_s = self.since_s + time.monotonic() - self._began_s
        status = self.rig.status()
        helpers = {name: int(status[f"{name}_pid"]) for name in HELPERS}
        for name, pid in ({"spine": self.rig.spine_pid} | helpers).items():
            for kind, value in growth.of_process(pid).items():
                self.series[f"{name}_{kind}"].append((pid, round(t_s, 1), value))
        segments = len(list(Path("/dev/shm").glob(f"{self.rig.prefix}.*")))
        self.series["shm_segments"].append((0, round(t_s, 1), float(segments)))
        self.book.read()
        if self.book.count >= 10:
            each_kb = growth.size_kb(self.rig.swaps) / self.book.count
            most = growth.MOST_KB_PER_CERTIFICATE
            self.judge.holds("growth", each_kb <= most, f"{each_kb:.1f} kB a certificate; {most:g} at most",
                             kb_per_certificate=each_kb)  # fmt: skip

    def close(self) -> None:
        """Ends the thread."""
        if self._thread is not None:
            self._thread.stop()
