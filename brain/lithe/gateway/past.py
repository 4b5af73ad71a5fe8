# SPDX-License-Identifier: Apache-2.0
"""The last minute of telemetry, thinned: the Spine itself keeps 4096 ticks. Threads: may be shared."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

import numpy as np
import numpy.typing as npt

from ..robot import Robot
from ..shm import dtype

KEPT_S = 60.0
KEPT_HZ = 50.0
READ_EVERY_S = 0.5  # far below the 4096 ticks that the Spine keeps, at any rate


class Past:
    """Reads all ticks from shared memory and keeps every `every`-th of the last 60 s, in a thread of its own."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._pieces: deque[npt.NDArray[Any]] = deque()
        self._lock = threading.Lock()
        self._spine = robot.spine
        self._cursor = self._spine.telemetry()
        threading.Thread(target=self._keep, name="lithe-gateway-past", daemon=True).start()

    @property
    def every(self) -> int:
        """Ticks from one record to the next."""
        return max(1, round(float(self._spine.info["rate_hz"]) / KEPT_HZ))

    def before(self, tick: int, since_ns: int) -> npt.NDArray[Any]:
        """The thinned records before that tick and since that time, oldest first, shape (n,)."""
        with self._lock:
            kept = np.concatenate([np.empty(0, dtype("Telemetry")), *self._pieces])
        recent: npt.NDArray[Any] = kept[(kept["release_ns"] > since_ns) & (kept["tick"] < tick)]
        return recent

    def window(self, seconds: float) -> tuple[npt.NDArray[Any], npt.NDArray[np.float64]]:
        """The records of the last `seconds`, oldest first, shape (n,), and how many ticks each stands for."""
        full = self._robot.telemetry.history(seconds)
        since_ns = int(full["release_ns"][-1] - seconds * 1e9) if len(full) else 0
        older = self.before(int(full["tick"][0]), since_ns) if len(full) else full
        return np.concatenate([older, full]), np.repeat([float(self.every), 1.0], [len(older), len(full)])

    def _keep(self) -> None:
        stop = threading.Event()
        while not stop.wait(READ_EVERY_S):
            spine = self._robot.spine
            if spine is not self._spine:  # another run of the robot: its ticks begin anew
                with self._lock:
                    self._pieces.clear()
                self._spine, self._cursor = spine, spine.telemetry()
            records = self._cursor.drain()
            thinned = records[records["tick"] % self.every == 0].copy()
            if not len(thinned):
                continue
            with self._lock:
                self._pieces.append(thinned)
                oldest_ns = int(thinned["release_ns"][-1]) - int(KEPT_S * 1e9)
                while self._pieces[0]["release_ns"][-1] < oldest_ns:
                    self._pieces.popleft()
