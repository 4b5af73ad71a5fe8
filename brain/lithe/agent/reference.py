# SPDX-License-Identifier: Apache-2.0
"""The motion by which laws are compared: a sine of each joint, within its limits, streamed as plans to the Spine."""

from __future__ import annotations

import math
import re
import threading
import time
from typing import Any

import numpy as np

from ..demo.brain import Reference
from ..demo.moves import FREQUENCY_HZ, sines
from ..errors import LitheError
from .link import Link

POINTS = 12
PERIOD_S = 0.02
RAMP_S = 1.0
HORIZON_S = 0.24  # on a fast connection
LEAST_HZ, MOST_HZ = 0.05, 5.0
MOST_GROWTH = 2.0  # of the amplitude from one generation to the next, whatever is asked for


def frequency_in(goal: str) -> float:
    """ "track 0.7 Hz" -> 0.7; without a number the demo's. LitheError: out of bounds."""
    found = re.search(r"(\d+(?:[.]\d+)?)\s*Hz\b", goal, re.I)
    frequency_hz = float(found[1]) if found else FREQUENCY_HZ
    if not LEAST_HZ <= frequency_hz <= MOST_HZ:
        raise LitheError(f"the goal asks for {frequency_hz:g} Hz\n  next: name one from {LEAST_HZ:g} to {MOST_HZ:g} Hz")
    return frequency_hz


def sine(joints: list[dict[str, Any]], frequency_hz: float, share: float) -> dict[str, Any]:
    """What the demo's verb `reference` takes: `share` (0 to 1) of the largest sine that the limits leave room for.

    Faster than 0.5 Hz its amplitude falls with the square, so that speed and acceleration never grow.
    """
    made = sines(joints)
    smaller = share * min(1.0, (FREQUENCY_HZ / frequency_hz) ** 2)
    made["amplitude_rad"] = [smaller * each for each in made["amplitude_rad"]]
    return made | {"frequency_hz": frequency_hz, "ramp_s": RAMP_S}


def grown(share: float, growth: float) -> float:
    """The share of the next generation."""
    return min(1.0, share * min(max(growth, 1.0), MOST_GROWTH))


class Streamer:
    """Publishes a sine over the connection until stop(), or by the application's verb `reference` where there is one.

    Plans reach further ahead the slower the connection is. When they end, the Spine slows the setpoint down and holds.
    """

    def __init__(self, link: Link) -> None:
        self._link, self._own = link, "reference" in link.application_verbs
        self._lock, self._end = threading.Lock(), threading.Event()
        self._thread: threading.Thread | None = None
        self._reference: Reference | None = None
        self.trouble = ""  # of the thread: why it ended
        sent_ns = time.monotonic_ns()
        robot_ns = int(link.call("describe").get("now_ns", sent_ns))
        self.delay_s = (time.monotonic_ns() - sent_ns) * 1e-9  # there and back
        self._ahead_ns = robot_ns - (sent_ns + time.monotonic_ns()) // 2

    def start(self, frequency_hz: float, share: float) -> None:
        """Fades the sine in from where the setpoint is; returns when it is there."""
        terms = sine(self._link.joints, frequency_hz, share)
        if self._own:
            self._link.call("reference", **terms)
        else:
            self._set(terms)
        self._link.sleep(RAMP_S + self.delay_s)

    def stop(self) -> None:
        """The setpoint comes to rest where it is."""
        if self._own:
            self._link.call("reference")
        elif self._thread is not None:
            self._end.set()
            self._thread.join(60.0)
            self._thread = None

    def _set(self, terms: dict[str, Any]) -> None:
        now = self._link.call("latest", fields=["setpoint_position_rad"])["setpoint_position_rad"]
        goal = [np.asarray(terms[name], dtype=float) for name in ("centre_rad", "amplitude_rad", "phase_rad")]
        start = np.asarray(now, dtype=float)
        made = Reference(self._now_ns(), start, goal[0], goal[1], goal[2], terms["frequency_hz"], terms["ramp_s"])
        with self._lock:
            self._reference = made
        if self._thread is None:
            self._end.clear()
            self._thread = threading.Thread(target=self._stream, name="lithe-agent-reference", daemon=True)
            self._thread.start()

    def _now_ns(self) -> int:
        return time.monotonic_ns() + self._ahead_ns

    def plan(self, reference: Reference, now_ns: int) -> dict[str, Any]:
        """The arguments of `publish`: waypoints from now on, with their speeds."""
        horizon_s = max(HORIZON_S, 3 * self.delay_s + 0.2)
        step_s = min(horizon_s / (POINTS - 1), 1 / (8 * reference.frequency_hz))
        t_ns = [now_ns + round(i * step_s * 1e9) for i in range(POINTS)]
        after, before = (reference.at([t + d for t in t_ns]) for d in (500_000, -500_000))
        return {
            "t_ns": t_ns,
            "position_rad": reference.at(t_ns).tolist(),
            "velocity_rad_s": ((after - before) / 1e-3).tolist(),
            "streaming": True,
        }

    def _stream(self) -> None:
        try:
            while not self._end.is_set():
                with self._lock:
                    reference = self._reference
                assert reference is not None
                self._link.call("publish", **self.plan(reference, self._now_ns()))
                self._end.wait(PERIOD_S + self.delay_s / 4)
        except LitheError as error:
            self.trouble = str(error)


def bad_share(share: float) -> str:
    """Why a share of the amplitude is no good; "" when it is."""
    return "" if math.isfinite(share) and 0 < share <= 1 else f"{share} is not between 0 and 1"
