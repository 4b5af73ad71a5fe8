# SPDX-License-Identifier: Apache-2.0
"""Telemetry as numpy arrays. Threads: may be shared. Errors: NotRunning."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from ._wire import SEGMENTS
from .errors import NotRunning
from .shm import RingCursor, SpineView, dtype

DEPTH = SEGMENTS["spine"]["telemetry"].depth


class Telemetry:
    """Telemetry: `robot.telemetry`. One record per tick, in private numpy copies.

    A record has the fields of message Telemetry (docs/reference/wire.md): records["position_rad"] has shape (n, 32) in
    rad, records["tick"] shape (n,); joints beyond the robot's own are zero. The Spine keeps the last 4096 ticks.

    All raise NotRunning once the robot has ended or was started again; drain() first returns the remaining records.
    """

    def __init__(self, spine: SpineView) -> None:
        self._lock = threading.Lock()
        self._lost = 0
        self._spine = spine
        self._cursor = spine.telemetry()

    def _attach(self, spine: SpineView) -> None:
        """Switches to another run of the robot; for Robot.reconnect()."""
        with self._lock:
            self._lost += self._cursor.lost
            self._spine = spine
            self._cursor = spine.telemetry()

    def _check(self) -> None:
        if not self._spine.mapping.is_current():
            raise NotRunning(
                f"robot '{self._spine.robot}' has ended, or was started again\n  next: robot.reconnect(), once it runs"
            )

    def latest(self) -> npt.NDArray[Any] | None:
        """The newest record, shape (); None before the first tick."""
        self._check()
        return self._cursor.latest()

    def drain(self) -> npt.NDArray[Any]:
        """All records since the last drain (or since connecting), oldest first, shape (n,)."""
        with self._lock:
            records = self._cursor.drain()
        if len(records) == 0:
            self._check()
        return records

    @property
    def lost(self) -> int:
        """Number of records that were overwritten before drain() read them, since connecting."""
        return self._lost + self._cursor.lost

    def history(self, seconds: float) -> npt.NDArray[Any]:
        """The last `seconds` of records, oldest first, shape (n,); at most the last 4096 ticks."""
        pieces, _ = self.pieces(DEPTH, seconds=seconds)
        return np.concatenate([*pieces, np.empty(0, dtype("Telemetry"))])

    def since(self, tick: int) -> tuple[npt.NDArray[Any], int]:
        """All records after that tick, oldest first, shape (n,), and the number of those that are no longer available.

        A tick in the future is from an earlier run of the robot: then all records of this run are returned.
        """
        pieces, wanted = self.pieces(DEPTH, since_tick=tick)
        records = np.concatenate([*pieces, np.empty(0, dtype("Telemetry"))])
        return records, wanted - len(records)

    def pieces(
        self, most: int, *, since_tick: int | None = None, seconds: float = 1.0
    ) -> tuple[Iterator[npt.NDArray[Any]], int]:
        """The records of since() or history(), in pieces of at most `most`, and their full number.

        The Spine continues between two pieces: records that it overwrites in that time are missing.
        """
        self._check()
        from_here = self._spine.telemetry()  # before the newest is read: the Spine goes on meanwhile
        newest = self._cursor.latest()
        if newest is None:
            return iter(()), 0
        last = int(newest["tick"])
        if since_tick is None:
            after_ns, first = int(newest["release_ns"]) - int(seconds * 1e9), 0
            back = min(DEPTH, max(0, int(seconds * float(self._spine.info["rate_hz"]))) + 2)
        else:
            after_ns, first = 0, 0 if since_tick > last else max(since_tick, 0)
            back = min(DEPTH, last - first + 1)

        def read(cursor: RingCursor) -> Iterator[npt.NDArray[Any]]:
            while len(records := cursor.drain(most)):
                wanted = (records["tick"] > first) & (records["tick"] <= last) & (records["release_ns"] > after_ns)
                yield records[wanted]
                if int(records["tick"][-1]) >= last:
                    return

        from_here.go_back(back)
        return read(from_here), last - first
