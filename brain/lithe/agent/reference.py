# SPDX-License-Identifier: Apache-2.0
"""The motion by which laws are compared: arguments of the verb `set_reference`, streamed by the gateway."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..demo.moves import FREQUENCY_HZ, sines
from ..errors import LitheError, Refused
from ..files import read_regular
from ..gateway.curves import curve_of
from .link import Link

RAMP_S = 1.0
SILENT_S = 60.0  # the link says something every ALIVE_S, however long a model thinks
MOST_GROWTH = 2.0  # of the amplitude from one generation to the next, whatever is asked for
MOST_WINDOW_S = 60.0  # what the verb `measure` looks back
KINDS = ("sine", "multisine", "chirp")
CHIRP_S = 10.0


@dataclass(frozen=True)
class Asked:
    """What the command line says of the motion; None: not said. `kind`: one of KINDS, or a JSON file of arguments."""

    kind: str = "sine"
    frequency_hz: list[float] | None = None
    amplitude_rad: list[float] | None = None
    centre_rad: list[float] | None = None
    duration_s: float = CHIRP_S


@dataclass(frozen=True)
class Reference:
    """`terms`: of set_reference, at full size. `words`: what it is and who said so. `whole_s`: one period, or its
    length where it does not repeat (`repeats`). `grows`: it has an amplitude that nobody asked for.
    """

    terms: dict[str, Any]
    words: str
    whole_s: float
    repeats: bool
    grows: bool

    def at(self, share: float) -> dict[str, Any]:
        """What set_reference takes, with that share (0 to 1) of the amplitude."""
        amplitude = {"amplitude_rad": [share * each for each in self.terms["amplitude_rad"]]} if self.grows else {}
        return self.terms | amplitude | {"ramp_s": RAMP_S, "client_stale_s": SILENT_S}

    def window_s(self, least_s: float) -> float:
        """So long is measured: whole periods, or the whole motion. LitheError: longer than the gateway looks back."""
        whole_s = self.whole_s * (math.ceil(least_s / self.whole_s - 1e-9) if self.repeats else 1)
        if whole_s > MOST_WINDOW_S:
            raise LitheError(
                f"one run of the reference takes {whole_s:g} s, at most {MOST_WINDOW_S:g} s are measured\n"
                "  next: a shorter one; of a multisine, frequencies that are multiples of a higher one"
            )
        return whole_s


def reference_of(joints: list[dict[str, Any]], goal: str, asked: Asked) -> Reference:
    """The motion that options, goal and the joints' limits make. LitheError: it is none."""
    try:
        if asked.kind in KINDS:
            return _swinging(joints, goal, asked)
        return _from_file(Path(asked.kind), len(joints))
    except Refused as refusal:
        raise LitheError(f"no reference: {refusal}") from None


def _swinging(joints: list[dict[str, Any]], goal: str, asked: Asked) -> Reference:
    hertz, source = asked.frequency_hz, "as asked"
    if hertz is None and asked.kind == "sine":
        found = re.search(r"(\d+(?:[.]\d+)?)\s*Hz\b", goal, re.I)
        hertz, source = ([float(found[1])], "from the goal's text") if found else ([FREQUENCY_HZ], "the default")
    if hertz is None or (asked.kind == "chirp" and len(hertz) != 2):
        what = "two: the first and the last" if asked.kind == "chirp" else "all of them"
        raise LitheError(f"a {asked.kind} needs its frequencies\n  next: --frequency-hz, {what}")
    usual = sines(joints)
    # Faster than the usual sine its amplitude falls with the square, so that speed and acceleration never grow.
    smaller = min(1.0, (FREQUENCY_HZ / max(*hertz, 1e-9)) ** 2)
    amplitude = asked.amplitude_rad or [smaller * each for each in usual["amplitude_rad"]]
    terms = {
        "kind": asked.kind, "centre_rad": asked.centre_rad or usual["centre_rad"],
        "amplitude_rad": amplitude if len(amplitude) == len(joints) else amplitude * len(joints),
    }  # fmt: skip
    if asked.kind == "sine":
        terms |= {"phase_rad": usual["phase_rad"], "frequency_hz": hertz if len(hertz) > 1 else hertz[0]}
    elif asked.kind == "multisine":
        terms |= {"frequency_hz": hertz}
    else:
        terms |= {"from_hz": hertz[0], "to_hz": hertz[1], "duration_s": asked.duration_s}
    whole_s = curve_of(terms, len(joints)).whole_s
    words = f"{asked.kind} {', '.join(f'{each:g}' for each in hertz)} Hz, {source}; amplitude "
    words += "as asked" if asked.amplitude_rad else "as the limits allow"
    return Reference(terms, words, whole_s, asked.kind != "chirp", asked.amplitude_rad is None)


def _from_file(path: Path, joints: int) -> Reference:
    """A file with the arguments of set_reference: also of those kinds that are no oscillation."""
    try:
        terms = json.loads(read_regular(path))
    except (OSError, ValueError) as error:
        raise LitheError(
            f"no reference: {path} ({error})\n"
            f"  next: --reference {', '.join(KINDS)}, or a JSON file with the arguments of set_reference"
        ) from None
    if not isinstance(terms, dict):
        raise LitheError(f"no reference: {path} holds no object\n  next: the arguments of set_reference, such as kind")
    curve = curve_of(terms, joints)
    return Reference(
        terms, f"{terms['kind']} of {path.name}", curve.whole_s, terms["kind"] in ("sine", "multisine"), False
    )  # fmt: skip


def grown(share: float, growth: float) -> float:
    """The share of the next generation."""
    return min(1.0, share * min(max(growth, 1.0), MOST_GROWTH))


class Streamer:
    """Has the gateway stream `reference` until stop(); the gateway ends it when this client is silent for SILENT_S."""

    def __init__(self, link: Link, reference: Reference) -> None:
        self._link, self.reference = link, reference
        self._terms: dict[str, Any] = {}

    def start(self, share: float) -> None:
        """Fades it in from where the setpoint is; returns when it is there. Refused: it would leave a limit.

        One that ends is run once, so that each later run begins where that one ended.
        """
        self._terms = self.reference.at(share)
        self.go_on()
        if not self.reference.repeats:
            self._link.sleep(self.reference.whole_s)

    def go_on(self) -> int:
        """Starts it again if it does not run, and one that ends in any case. Since when it runs [ns]."""
        told = self._link.call("reference")
        if self._terms and (told.get("asked") != self._terms or not self.reference.repeats):
            told = self._link.call("set_reference", **self._terms)
            if self.reference.repeats:
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
