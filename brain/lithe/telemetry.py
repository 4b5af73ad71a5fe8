# SPDX-License-Identifier: Apache-2.0
"""What the Spine measured, as numpy arrays. Threads: may be shared. Errors: NotRunning."""

from __future__ import annotations

import threading
from typing import Any

import numpy.typing as npt

from .errors import NotRunning
from .shm import SpineView


class Telemetry:
    """What the Spine measured: `robot.telemetry`. One record per tick, in private numpy copies.

    A record has the fields of message Telemetry (docs/reference/wire.md): records["position_rad"] has shape (n, 32) in
    rad, records["tick"] shape (n,); joints beyond the robot's own are zero. The Spine keeps the last 4096 ticks.

    All raise NotRunning once the robot has ended or was started anew; drain() first gives what was left.
    """

    def __init__(self, spine: SpineView) -> None:
        self._lock = threading.Lock()
        self._lost = 0
        self._spine = spine
        self._cursor = spine.telemetry()

    def _attach(self, spine: SpineView) -> None:
        """Goes on with another run of the robot; for Robot.reconnect()."""
        with self._lock:
            self._lost += self._cursor.lost
            self._spine = spine
            self._cursor = spine.telemetry()

    def _check(self) -> None:
        if not self._spine.mapping.is_current():
            raise NotRunning(
                f"robot '{self._spine.robot}' has ended, or was started anew\n  next: robot.reconnect(), once it runs"
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
        """Records that drain() came too late for, since connecting."""
        return self._lost + self._cursor.lost

    def history(self, seconds: float) -> npt.NDArray[Any]:
        """The last `seconds` of records, oldest first, shape (n,); at most the last 4096 ticks."""
        records = self._all()
        if len(records) == 0:
            return records
        recent: npt.NDArray[Any] = records[records["release_ns"] > records["release_ns"][-1] - int(seconds * 1e9)]
        return recent

    def since(self, tick: int) -> tuple[npt.NDArray[Any], int]:
        """All records after that tick, oldest first, shape (n,), and how many there were that are gone by now.

        A tick that is yet to come is one of an earlier run of the robot: then all records of this run are given.
        """
        records = self._all()
        if len(records) == 0:
            return records, 0
        newest = int(records["tick"][-1])
        tick = 0 if tick > newest else max(tick, 0)
        wanted: npt.NDArray[Any] = records[records["tick"] > tick]
        return wanted, newest - tick - len(wanted)

    def _all(self) -> npt.NDArray[Any]:
        self._check()
        return self._spine.telemetry(from_oldest=True).drain()
