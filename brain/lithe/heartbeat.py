# SPDX-License-Identifier: Apache-2.0
"""The Brain's heartbeat, sent by a thread: it ends or stops together with the process."""

from __future__ import annotations

import threading
import tomllib
from collections.abc import Callable
from pathlib import Path

from .files import read_regular

LONGEST_S, SHORTEST_S = 0.05, 0.002
UNKNOWN_LIMIT_S = 0.1  # when the robot file cannot be read: short enough for almost every robot
BEATS_PER_LIMIT = 5


def period_s(robot_file: Path) -> float:
    """How often to beat: five times within the `[brain] stale_after_s` of the robot's file, at least every 50 ms."""
    try:
        limit_s = float(tomllib.loads(read_regular(robot_file))["brain"]["stale_after_s"])
    except (OSError, ValueError, KeyError, TypeError):
        limit_s = UNKNOWN_LIMIT_S
    return min(LONGEST_S, max(SHORTEST_S, limit_s / BEATS_PER_LIMIT))


class Repeat:
    """Calls a function every `every_s` from a daemon thread, at once for the first time, until stop()."""

    def __init__(self, call: Callable[[], None], every_s: float) -> None:
        self._call, self._every_s = call, every_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"lithe-{type(self).__name__.lower()}", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.is_set():
            self._call()
            self._stop.wait(self._every_s)

    def stop(self) -> None:
        """Returns when the last call is over."""
        self._stop.set()
        self._thread.join()


class Heartbeat(Repeat):
    """The Brain's sign of life: each beat is one store to shared memory."""
