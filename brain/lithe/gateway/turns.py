# SPDX-License-Identifier: Apache-2.0
"""Scheduling in the gateway: verbs that move or stop the robot first, long answers one at a time.

Python runs one thread at a time, so a long answer that is made in one go keeps every other client waiting. It is made
in pieces; between two of them it lets the others run, and waits while a moving verb is being served.

Threads: all methods may be called from any thread.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Iterator

MOST_PAUSE_S = 0.1  # before each piece: a stream of moving verbs slows long answers down and does not end them
MOST_UNSENT_BYTES = 32 << 20  # of long answers that are made and not yet read, of all clients together


class Turns:
    """See above. `pieces` counts those of long answers made so far."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._moving = 0
        self._waiting: deque[object] = deque()  # for the turn to make a long answer; the first one has it
        self.unsent_bytes = 0
        self.pieces = 0

    @contextlib.contextmanager
    def moving(self) -> Iterator[None]:
        """While a verb is served that moves or stops the robot."""
        with self._changed:
            self._moving += 1
        try:
            yield
        finally:
            with self._changed:
                self._moving -= 1
                self._changed.notify_all()

    @contextlib.contextmanager
    def long_answer(self) -> Iterator[None]:
        """While a long answer is made: one at a time, in the order in which they were asked for."""
        mine = object()
        with self._changed:
            self._waiting.append(mine)
            self._changed.wait_for(lambda: self._waiting[0] is mine)
        try:
            yield
        finally:
            with self._changed:
                self._waiting.remove(mine)
                self._changed.notify_all()

    def pause(self) -> None:
        """Between two pieces of a long answer."""
        time.sleep(0)  # lets a thread that waits for the interpreter lock run
        with self._changed:
            self._changed.wait_for(lambda: self._moving == 0, MOST_PAUSE_S)
            self.pieces += 1

    def keep(self, size_bytes: int) -> None:
        """Before a long answer of that size is left to be sent: waits until there is room for it."""
        with self._changed:
            self._changed.wait_for(
                lambda: self.unsent_bytes == 0 or self.unsent_bytes + size_bytes <= MOST_UNSENT_BYTES
            )
            self.unsent_bytes += size_bytes

    def drop(self, size_bytes: int) -> None:
        """The answer was sent, or is dropped."""
        with self._changed:
            self.unsent_bytes -= size_bytes
            self._changed.notify_all()
