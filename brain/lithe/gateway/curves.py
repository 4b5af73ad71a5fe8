# SPDX-License-Identifier: Apache-2.0
"""The shapes of references: sine, multisine, chirp, steps, waypoints; and what their arguments may be."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import Refused

HIGHEST_HZ = 5.0  # ten points of a plan in a period
MOST_POINTS = 1000
LONGEST_S = 3600.0  # of a reference that does not repeat
FINEST_HZ = 1e-4  # frequencies on this grid have a common period

Vector = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Curve:
    """Times since the start [s] (n,) -> angles [rad] (n, joints). After `whole_s` it rests or repeats itself; a period
    longer than LONGEST_S counts as that. `swings`: centre [rad], most deviation [rad] and most speed [rad/s] of each
    joint, where these are known without looking.
    """

    at: Callable[[Vector], Vector]
    whole_s: float
    swings: tuple[Vector, Vector, Vector] | None = None

    def __call__(self, t_s: Vector) -> Vector:
        return self.at(t_s)


class Args:
    """The arguments of one reference. Each that is not used is refused."""

    def __init__(self, args: dict[str, Any], joints: int) -> None:
        self._left, self._joints = dict(args), joints

    def _array(self, name: str, usual: Any) -> Vector:
        given = self._left.pop(name, usual)
        try:
            value = np.asarray(given, dtype=np.float64)
        except (TypeError, ValueError):
            raise Refused("usage", f"'{name}' is not made of numbers", "the document agents has its form") from None
        if not np.isfinite(value).all():
            raise Refused("usage", f"'{name}' holds a number that is not finite", "give finite numbers")
        return value

    def each(self, name: str, usual: Any = None) -> Vector:
        """One number for all joints, or one for each -> (joints,)."""
        value = self._array(name, usual)
        if value.shape not in ((), (1,), (self._joints,)):
            raise Refused(
                "usage", f"'{name}' has shape {value.shape}", f"one number, or one for each of {self._joints} joints"
            )
        return np.broadcast_to(value, (self._joints,)).copy()

    def number(self, name: str, usual: float | None, least: float, most: float) -> float:
        value = self._array(name, usual)
        if value.shape != () or not least <= float(value) <= most:
            raise Refused("usage", f"'{name}' is {value.tolist()}", f"one number from {least:g} to {most:g}")
        return float(value)

    def times(self, name: str) -> Vector:
        """Ascending times [s] -> (n,)."""
        value = self._array(name, None)
        if value.ndim != 1 or not 1 <= len(value) <= MOST_POINTS or value[0] < 0 or (np.diff(value) <= 0).any():
            raise Refused("usage", f"'{name}' is not 1 to {MOST_POINTS} ascending times", "seconds from the start")
        _check_length(float(value[-1]))
        return value

    def rows(self, name: str, count: int | None = None) -> Vector:
        """Rows of angles, one number per joint -> (n, joints)."""
        value = self._array(name, None)
        if value.ndim == 1 and self._joints == 1:
            value = value[:, None]
        fits = value.ndim == 2 and value.shape[1] == self._joints and 1 <= len(value) <= MOST_POINTS
        if not fits or (count is not None and len(value) != count):
            many = f"{count}" if count is not None else f"1 to {MOST_POINTS}"
            raise Refused("usage", f"'{name}' has shape {value.shape}", f"{many} rows of {self._joints} numbers")
        return value

    def frequencies(self, name: str) -> Vector:
        """Frequencies [Hz] above 0 that plans can carry -> (n,)."""
        given = self._left.get(name)
        value = np.atleast_1d(self._array(name, None))
        if value.ndim != 1 or not 1 <= len(value) <= 64:
            raise Refused("usage", f"'{name}' has shape {value.shape}", "1 to 64 frequencies")
        return _in_range(name, given, value)

    def each_frequency(self, name: str) -> Vector:
        """One frequency [Hz] for all joints, or one for each -> (joints,)."""
        given = self._left.get(name)
        return _in_range(name, given, self.each(name))

    def end(self, kind: str) -> None:
        if self._left:
            names = " and ".join(repr(name) for name in sorted(self._left))
            raise Refused("usage", f"a reference of kind '{kind}' has no argument {names}", "leave it out")


def _in_range(name: str, given: Any, value: Vector) -> Vector:
    if value.min() <= 0 or value.max() > HIGHEST_HZ:
        next_step = f"above 0 and at most {HIGHEST_HZ:g} Hz: a plan has a point every 20 ms"
        raise Refused("usage", f"'{name}' is {given}", next_step)
    return value


def _check_length(length_s: float) -> None:
    if length_s > LONGEST_S:
        raise Refused("usage", f"the reference takes {length_s:g} s", f"at most {LONGEST_S:g} s; set the rest later")


def _smooth(x: Vector) -> Vector:
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3 - 2 * x)


def _sine(args: Args) -> Curve:
    centre, amplitude, phase = args.each("centre_rad"), args.each("amplitude_rad"), args.each("phase_rad", 0.0)
    hertz = args.each_frequency("frequency_hz")
    omega = 2 * math.pi * hertz

    def curve(t: Vector) -> Vector:
        swing: Vector = centre + amplitude * np.sin(omega * t[:, None] + phase)
        return swing

    return Curve(
        curve, min(1 / float(hertz.min()), LONGEST_S)
    )  # each joint for itself: the slowest has been round once


def _multisine(args: Args) -> Curve:
    centre, amplitude = args.each("centre_rad"), args.each("amplitude_rad")
    hertz = args.frequencies("frequency_hz")
    omega = 2 * math.pi * hertz
    k = np.arange(1, len(omega) + 1)
    # Schroeder 1970: a low crest factor; other phases for each joint.
    phase = (-np.pi * k * (k - 1) / len(omega))[:, None] + k[:, None] * np.arange(len(centre))
    sine, cosine = np.sin(phase) / len(omega), np.cos(phase) / len(omega)

    def curve(t: Vector) -> Vector:
        angle = omega * t[:, None]
        swing: Vector = centre + amplitude * (np.sin(angle) @ cosine + np.cos(angle) @ sine)
        return swing

    steps = np.round(hertz / FINEST_HZ)
    common = bool((steps >= 1).all()) and np.allclose(steps * FINEST_HZ, hertz, rtol=0, atol=1e-9)
    period_s = 1 / (FINEST_HZ * int(np.gcd.reduce(steps.astype(np.int64)))) if common else LONGEST_S
    return Curve(curve, min(period_s, LONGEST_S), (centre, np.abs(amplitude), np.abs(amplitude) * omega.mean()))


def _chirp(args: Args) -> Curve:
    centre, amplitude = args.each("centre_rad"), args.each("amplitude_rad")
    first, last = (args.number(name, None, 0.0, HIGHEST_HZ) for name in ("from_hz", "to_hz"))
    length_s = args.number("duration_s", None, 0.1, LONGEST_S)

    def curve(t: Vector) -> Vector:
        u = np.clip(t, 0.0, length_s)
        fade = 1 - _smooth((t - 0.9 * length_s) / (0.1 * length_s))  # ends at its centre
        angle = 2 * math.pi * (first * u + 0.5 * (last - first) * u * u / length_s)
        swing: Vector = centre + amplitude * (fade * np.sin(angle))[:, None]
        return swing

    return Curve(curve, length_s)


def _steps(args: Args) -> Curve:
    rows = args.rows("position_rad")
    every_s, rise_s = args.number("every_s", None, 0.05, 3600.0), args.number("rise_s", 0.2, 0.05, 60.0)
    if rise_s > every_s:
        raise Refused("usage", f"rise_s {rise_s:g} is longer than every_s {every_s:g}", "give a shorter rise_s")
    _check_length(every_s * len(rows))

    def curve(t: Vector) -> Vector:
        turn = np.minimum((np.maximum(t, 0.0) / every_s).astype(np.int64), len(rows) - 1)
        share = _smooth((t - turn * every_s) / rise_s)[:, None]
        before = rows[np.maximum(turn - 1, 0)]
        step: Vector = before + share * (rows[turn] - before)
        return step

    return Curve(curve, every_s * len(rows))


def _waypoints(args: Args) -> Curve:
    times = args.times("t_s")
    rows = args.rows("position_rad", len(times))

    def curve(t: Vector) -> Vector:
        if len(times) == 1:
            return np.repeat(rows, len(t), axis=0)
        at = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
        share = _smooth((t - times[at]) / (times[at + 1] - times[at]))[:, None]
        way: Vector = rows[at] + share * (rows[at + 1] - rows[at])
        return way

    return Curve(curve, float(times[-1]))


KINDS: dict[str, Callable[[Args], Curve]] = {
    "sine": _sine, "multisine": _multisine, "chirp": _chirp, "steps": _steps, "waypoints": _waypoints,
}  # fmt: skip

SWINGS = ("centre_rad", "amplitude_rad")
NEEDS = {
    "sine": (*SWINGS, "frequency_hz"), "multisine": (*SWINGS, "frequency_hz"),
    "chirp": (*SWINGS, "from_hz", "to_hz", "duration_s"), "steps": ("position_rad", "every_s"),
    "waypoints": ("t_s", "position_rad"),
}  # fmt: skip


def curve_of(args: dict[str, Any], joints: int) -> Curve:
    """The curve of a reference: its `kind` and that kind's arguments. Raises Refused where they are wrong."""
    rest = dict(args)
    kind = str(rest.pop("kind", ""))
    if kind not in KINDS:
        raise Refused("usage", f"there is no reference of kind '{kind}'", f"one of: rest, {', '.join(KINDS)}")
    missing = [name for name in NEEDS[kind] if rest.get(name) is None]
    if missing:
        names = " and ".join(repr(name) for name in missing)
        raise Refused("usage", f"a reference of kind '{kind}' needs {names}", f"give {', '.join(missing)}")
    given = Args(rest, joints)
    curve = KINDS[kind](given)
    given.end(kind)
    return curve
