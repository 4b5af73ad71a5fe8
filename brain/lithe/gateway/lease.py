# SPDX-License-Identifier: Apache-2.0
"""Who may move the robot, when several clients could: one of them takes the lease, the others read.

Without a lease every client may move it. Stops and steps back never need one.
"""

from __future__ import annotations

import threading
import time
from typing import Any

from ..errors import Refused

USUAL_S, MOST_S = 30.0, 600.0


class Lease:
    """At most one client holds it. Its time begins anew with each of its verbs that moves the robot; it ends by itself,
    when it is given back, and when the client has left.

    Threads: all methods may be called from any thread. `who` is any object, compared by ==, `name` what others are told
    of it.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._holder: object = None
        self._name = ""
        self._lasts_s = 0.0
        self._end_s = 0.0

    def take(self, who: object, name: str, seconds: float = USUAL_S) -> dict[str, Any]:
        """Takes or prolongs it. Raises Refused (`leased`) while another has it."""
        if not 0 < seconds <= MOST_S:
            raise Refused("usage", f"seconds = {seconds:g}", f"above 0, at most {MOST_S:g}")
        with self._lock:
            self._check(who)
            self._holder, self._name, self._lasts_s = who, name, seconds
            self._end_s = time.monotonic() + seconds
            return self._told(who)

    def give_back(self, who: object) -> None:
        """Nothing happens when another has it."""
        with self._lock:
            if self._holder == who:
                self._holder = None

    def left(self, who: object, away_s: float) -> None:
        """That client has gone; it keeps the lease for so long, to come back."""
        with self._lock:
            if self._holder == who:
                self._end_s = min(self._end_s, time.monotonic() + away_s)

    def moves(self, who: object) -> None:
        """Before a verb that moves the robot. Raises Refused (`leased`) while another has the lease."""
        with self._lock:
            self._check(who)
            if self._holder == who and who is not None:
                self._end_s = time.monotonic() + self._lasts_s

    def told(self, who: object) -> dict[str, Any]:
        """`holder`: who has it (null: nobody), `yours`, `left_s`."""
        with self._lock:
            return self._told(who)

    def _held(self) -> bool:
        return self._holder is not None and time.monotonic() < self._end_s

    def _check(self, who: object) -> None:
        if self._held() and self._holder != who:
            left_s = self._end_s - time.monotonic()
            raise Refused(
                "leased",
                f"{self._name} has the right to move this robot for another {left_s:.1f} s",
                "wait, or ask it to give the lease back; stops and rollback need none",
            )

    def _told(self, who: object) -> dict[str, Any]:
        held = self._held()
        return {
            "holder": self._name if held else None,
            "yours": held and self._holder == who,
            "left_s": round(self._end_s - time.monotonic(), 1) if held else 0.0,
        }
