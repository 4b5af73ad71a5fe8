# SPDX-License-Identifier: Apache-2.0
"""The motion by which laws are compared: a sine of each joint, within its limits, streamed by the gateway."""

from __future__ import annotations

import math
import re
from typing import Any

from ..demo.moves import FREQUENCY_HZ, sines
from ..errors import LitheError
from .link import Link

RAMP_S = 1.0
SILENT_S = 60.0  # the link says something every ALIVE_S, however long a model thinks
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
    """What the verb `set_reference` takes: `share` (0 to 1) of the largest sine that the limits leave room for.

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
    """Has the gateway stream a sine until stop(); the gateway ends it when this client has been gone for SILENT_S."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._terms: dict[str, Any] = {}

    def start(self, frequency_hz: float, share: float) -> None:
        """Fades the sine in from where the setpoint is; returns when it is there. Refused: it would leave a limit."""
        self._terms = sine(self._link.joints, frequency_hz, share) | {"client_stale_s": SILENT_S}
        self.go_on()

    def go_on(self) -> int:
        """Starts it again if it does not run: a connection that breaks ends it. Since when it runs [ns]."""
        told = self._link.call("reference")
        if self._terms and told.get("asked") != self._terms:
            told = self._link.call("set_reference", **self._terms)
            self._link.sleep(float(told["ramp_s"]))
        return int(told.get("since_ns", 0))

    def went_on(self, since_ns: int) -> bool:
        """Whether it has run all the while since go_on() returned that."""
        told = self._link.call("reference")
        return bool(told.get("asked") == self._terms and told.get("since_ns", 0) == since_ns)

    def stop(self) -> None:
        """The setpoint comes to rest where it is."""
        self._terms = {}
        self._link.call("stop_reference")


def bad_share(share: float) -> str:
    """Why a share of the amplitude is no good; "" when it is."""
    return "" if math.isfinite(share) and 0 < share <= 1 else f"{share} is not between 0 and 1"
