# SPDX-License-Identifier: Apache-2.0
"""References that are streamed to the Spine as plans: rest, steps, sine, multisine, chirp, waypoints.

A reference is checked against the joints' limits before it starts, and begins where the joints are, with the speed of
the setpoint. It ends at rest: when it is stopped, and when the client that set it has left or been silent for too long.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from .._wire import Mode
from ..errors import LitheError, Refused
from ..robot import Robot

PERIOD_NS = 20_000_000  # between two points of a plan
POINTS = 12
HIGHEST_HZ = 5.0  # ten points in a period
MOST_POINTS = 1000
COAST_S = 0.5  # from the setpoint's speed to rest
FAR_RAD = 0.1  # a setpoint that far from its joint is not where the joint is
USUAL_RAMP_S = 1.0
CHECKED_S = 60.0  # of a reference, in steps of CHECK_STEP_S
CHECK_STEP_S = 0.005
ROUNDING_RAD = 1e-9
_RESTS: dict[str, Any] = {"kind": "rest"}
_OF_ALL = ("stay", "client_stale_s", "ramp_s")  # arguments of every kind

Vector = npt.NDArray[np.float64]
Curve = Callable[[Vector], Vector]


@dataclass(frozen=True)
class Limits:
    """Of each joint, by name; arrays of shape (joints,)."""

    names: list[str]
    least_rad: Vector
    most_rad: Vector
    speed_rad_s: Vector


@dataclass(frozen=True)
class Reference:
    """Angles over time: `curve`, faded in within `ramp_s` from where the joints were and how fast the setpoint was.

    curve: times since the start [s] (n,) -> angles [rad] (n, joints). None: it comes to rest.
    """

    since_ns: int
    start_rad: Vector
    speed_rad_s: Vector
    curve: Curve | None = None
    ramp_s: float = USUAL_RAMP_S
    asked: dict[str, Any] = field(default_factory=lambda: dict(_RESTS))
    ends: bool = False  # nothing is published once it rests: other plans have the robot again

    def after(self, t_s: Vector) -> Vector:
        """Angles [rad] (n, joints) at times [s] (n,) since the start."""
        s = np.clip(t_s[:, None] / COAST_S, 0.0, 1.0)
        coast: Vector = self.start_rad + self.speed_rad_s * COAST_S * (s - s * s + s**3 / 3)
        if self.curve is None:
            return coast
        x = np.clip(t_s[:, None] / self.ramp_s, 0.0, 1.0)
        blend = x**3 * (10 - 15 * x + 6 * x * x)  # minimum jerk
        return coast + blend * (self.curve(t_s) - coast)

    def at(self, t_ns: Sequence[int]) -> Vector:
        """Angles [rad] (n, joints) at times of CLOCK_MONOTONIC [ns]."""
        since_ns = np.asarray(t_ns, dtype=np.int64) - self.since_ns
        return self.after(np.asarray(since_ns * 1e-9, dtype=np.float64))


class _Args:
    """The arguments of one reference. Each that is not used is refused."""

    def __init__(self, args: dict[str, Any], joints: int) -> None:
        self._left, self._joints = dict(args), joints

    def _array(self, name: str, usual: Any) -> Vector:
        given = self._left.pop(name, usual)
        if given is None:
            raise Refused("usage", f"a reference of this kind needs '{name}'", f"give {name}")
        try:
            value = np.asarray(given, dtype=np.float64)
        except (TypeError, ValueError):
            raise Refused("usage", f"'{name}' is not made of numbers", f"give {name} as in docs/agents.md") from None
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
        value = np.atleast_1d(self._array(name, None))
        if value.ndim != 1 or not 1 <= len(value) <= 64 or value.min() <= 0 or value.max() > HIGHEST_HZ:
            raise Refused(
                "usage",
                f"'{name}' is {value.tolist()}",
                f"above 0 and at most {HIGHEST_HZ:g} Hz: a plan has a point every {PERIOD_NS // 1_000_000} ms",
            )
        return value

    def end(self, kind: str) -> None:
        if self._left:
            raise Refused("usage", f"a reference of kind '{kind}' has no argument '{min(self._left)}'", "leave it out")


def _smooth(x: Vector) -> Vector:
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3 - 2 * x)


def _sine(args: _Args) -> Curve:
    centre, amplitude, phase = args.each("centre_rad"), args.each("amplitude_rad"), args.each("phase_rad", 0.0)
    omega = 2 * math.pi * float(args.frequencies("frequency_hz")[0])
    return lambda t: centre + amplitude * np.sin(omega * t[:, None] + phase)


def _multisine(args: _Args) -> Curve:
    centre, amplitude = args.each("centre_rad"), args.each("amplitude_rad")
    omega = 2 * math.pi * args.frequencies("frequency_hz")
    k = np.arange(1, len(omega) + 1)
    phase = -np.pi * k * (k - 1) / len(omega)  # Schroeder 1970: a low crest factor
    joint = np.arange(len(centre))[:, None] * k  # other phases for each joint

    def curve(t: Vector) -> Vector:
        waves = np.sin(omega * t[:, None, None] + phase + joint)
        swing: Vector = centre + amplitude * waves.mean(axis=2)
        return swing

    return curve


def _chirp(args: _Args) -> Curve:
    centre, amplitude = args.each("centre_rad"), args.each("amplitude_rad")
    first, last = (float(args.frequencies(name)[0]) for name in ("from_hz", "to_hz"))
    length_s = args.number("duration_s", None, 0.1, 3600.0)

    def curve(t: Vector) -> Vector:
        u = np.clip(t, 0.0, length_s)
        fade = 1 - _smooth((t - 0.9 * length_s) / (0.1 * length_s))  # ends at its centre
        angle = 2 * math.pi * (first * u + 0.5 * (last - first) * u * u / length_s)
        swing: Vector = centre + amplitude * (fade * np.sin(angle))[:, None]
        return swing

    return curve


def _steps(args: _Args) -> Curve:
    rows = args.rows("position_rad")
    every_s, rise_s = args.number("every_s", None, 0.05, 3600.0), args.number("rise_s", 0.2, 0.05, 60.0)
    if rise_s > every_s:
        raise Refused("usage", f"rise_s {rise_s:g} is longer than every_s {every_s:g}", "give a shorter rise_s")

    def curve(t: Vector) -> Vector:
        turn = np.minimum((np.maximum(t, 0.0) / every_s).astype(np.int64), len(rows) - 1)
        share = _smooth((t - turn * every_s) / rise_s)[:, None]
        before = rows[np.maximum(turn - 1, 0)]
        step: Vector = before + share * (rows[turn] - before)
        return step

    return curve


def _waypoints(args: _Args) -> Curve:
    times = args.times("t_s")
    rows = args.rows("position_rad", len(times))

    def curve(t: Vector) -> Vector:
        if len(times) == 1:
            return np.repeat(rows, len(t), axis=0)
        at = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
        share = _smooth((t - times[at]) / (times[at + 1] - times[at]))[:, None]
        way: Vector = rows[at] + share * (rows[at + 1] - rows[at])
        return way

    return curve


KINDS: dict[str, Callable[[_Args], Curve]] = {
    "sine": _sine, "multisine": _multisine, "chirp": _chirp, "steps": _steps, "waypoints": _waypoints,
}  # fmt: skip


def curve_of(args: dict[str, Any], joints: int) -> Curve:
    """The curve of a reference: its `kind` and that kind's arguments. Raises Refused where they are wrong."""
    rest = dict(args)
    kind = str(rest.pop("kind", ""))
    if kind not in KINDS:
        raise Refused("usage", f"there is no reference of kind '{kind}'", f"one of: rest, {', '.join(KINDS)}")
    given = _Args(rest, joints)
    curve = KINDS[kind](given)
    given.end(kind)
    return curve


def least_ramp_s(curve: Curve, start_rad: Vector, limits: Limits) -> float:
    """A time [s] to fade in that takes at most half of each joint's speed limit; a minimum jerk peaks at 15/8."""
    way_rad = np.abs(curve(np.arange(0.0, CHECKED_S, CHECK_STEP_S, dtype=np.float64)) - start_rad).max(axis=0)
    return float(np.max(15 / 8 * way_rad / (0.5 * limits.speed_rad_s)))


def check(reference: Reference, limits: Limits) -> None:
    """Raises Refused when the first minute of it leaves a joint's range or is too fast: joint, value, limit, time."""
    t_s = np.arange(0.0, CHECKED_S, CHECK_STEP_S, dtype=np.float64)
    angles = reference.after(t_s)
    speeds = np.diff(angles, axis=0) / CHECK_STEP_S
    for j, name in enumerate(limits.names):
        for sign, limit in ((1.0, limits.most_rad[j]), (-1.0, limits.least_rad[j])):
            at = int(np.argmax(sign * angles[:, j]))
            if sign * (angles[at, j] - limit) > ROUNDING_RAD:
                raise Refused(
                    "refused_limit",
                    f"joint '{name}' would be at {angles[at, j]:.3f} rad after {t_s[at]:.2f} s, "
                    f"its limit is {limit:.3f} rad",
                    "a smaller amplitude, or another centre",
                )
        at = int(np.argmax(np.abs(speeds[:, j])))
        if abs(speeds[at, j]) > limits.speed_rad_s[j]:
            raise Refused(
                "refused_limit",
                f"joint '{name}' would move at {abs(speeds[at, j]):.2f} rad/s after {t_s[at]:.2f} s, its limit is "
                f"{limits.speed_rad_s[j]:.2f} rad/s",
                "a lower frequency, a smaller amplitude, or a longer ramp_s",
            )


class References:
    """Streams one reference at a time to the Spine, from a thread of its own once the first one is set; one that ended
    is streamed until it rests.

    Threads: all methods may be called from any thread. `owner` is whoever set the reference, compared by ==.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._lock = threading.Lock()
        self._now: Reference | None = None
        self._owner: object = None
        self._stale_s = math.inf
        self._heard_ns = 0
        self._why = "none was set"
        self._thread: threading.Thread | None = None

    def limits(self) -> Limits:
        """Those of the robot."""
        spine = self._robot.spine
        each = {name: np.array(spine.info[name][: spine.joint_count], dtype=np.float64)
                for name in ("position_min_rad", "position_max_rad", "velocity_max_rad_s")}  # fmt: skip
        return Limits(
            list(spine.joint_names), each["position_min_rad"], each["position_max_rad"], each["velocity_max_rad_s"]
        )

    def set(self, args: dict[str, Any], owner: object = None) -> dict[str, Any]:
        """Starts a reference: `kind` and its arguments (docs/agents.md); returns what runs.

        stay: it goes on without its client. client_stale_s: without it, it ends after this time without a word.
        """
        joints = self._robot.spine.joint_count
        kind, stay = str(args.get("kind", "")), bool(args.get("stay", False))
        given = _Args({name: value for name, value in args.items() if name in _OF_ALL}, joints)
        stale_s = given.number("client_stale_s", 5.0, 0.1, 3600.0)
        ramp_s = given.number("ramp_s", USUAL_RAMP_S, 0.1, 60.0)
        own = {name: value for name, value in args.items() if name not in _OF_ALL}
        if kind == "rest":
            curve = None
            _Args({name: value for name, value in own.items() if name != "kind"}, joints).end(kind)
        else:
            curve = curve_of(own, joints)
        start_rad, speed_rad_s = self._where(curve is None)
        limits = self.limits()
        if curve is not None:
            ramp_s = max(ramp_s, least_ramp_s(curve, start_rad, limits))
        made = Reference(time.monotonic_ns(), start_rad, speed_rad_s, curve, ramp_s, dict(args))
        check(made, limits)
        with self._lock:
            self._now, self._owner, self._why = made, owner, ""
            self._stale_s = math.inf if stay else stale_s
            self._heard_ns = time.monotonic_ns()
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="lithe-references", daemon=True)
                self._thread.start()
        return self.told()

    def heard(self, owner: object) -> None:
        """That client has said something."""
        with self._lock:
            if owner is not None and owner == self._owner:
                self._heard_ns = time.monotonic_ns()

    def left(self, owner: object) -> None:
        """That client has gone: its reference ends, unless it was to stay."""
        with self._lock:
            ends = self._now is not None and owner == self._owner and math.isfinite(self._stale_s)
        if ends:
            self.stop("its client has left")

    def stop(self, why: str = "stopped") -> dict[str, Any]:
        """Comes to rest within COAST_S; returns what runs."""
        with self._lock:
            running = self._now is not None and self._now.curve is not None
        if running:
            start_rad, speed_rad_s = self._where(False)
            with self._lock:
                self._now = Reference(time.monotonic_ns(), start_rad, speed_rad_s, ends=True)
                self._stale_s, self._why = math.inf, why
        return self.told()

    def told(self) -> dict[str, Any]:
        """`asked` (as it was set; kind rest: none), since_ns, and why the one before ended."""
        with self._lock:
            now = self._now
            return {
                "asked": dict(now.asked) if now else dict(_RESTS),
                "since_ns": now.since_ns if now else 0,
                "ramp_s": now.ramp_s if now else 0.0,
                "streams": now is not None,
                "ended": self._why,
            }

    def _where(self, measured_only: bool) -> tuple[Vector, Vector]:
        """Where setpoint or joints are [rad], and the setpoint's speed [rad/s]; within the limits."""
        count, limits = self._robot.spine.joint_count, self.limits()
        record = self._robot.spine.latest()
        if record is None:
            raise Refused("not_ready", "the robot has not ticked yet", "ask again")
        measured = np.array(record["position_rad"][:count], dtype=np.float64)
        setpoint = np.array(record["setpoint_position_rad"][:count], dtype=np.float64)
        follows = (int(record["mode"]) == Mode.active) & (np.abs(setpoint - measured) < FAR_RAD)
        speed = np.where(follows, np.array(record["setpoint_velocity_rad_s"][:count], dtype=np.float64), 0.0)
        start = np.clip(np.where(follows & (not measured_only), setpoint, measured), limits.least_rad, limits.most_rad)
        room = np.where(speed > 0, limits.most_rad - start, start - limits.least_rad)
        return start, np.sign(speed) * np.minimum(np.abs(speed), np.maximum(3 * room / COAST_S, 0.0))

    def _run(self) -> None:
        while True:
            with self._lock:
                now = self._now
                silent_s = 1e-9 * (time.monotonic_ns() - self._heard_ns)
                stale = now is not None and silent_s > self._stale_s
            try:
                if stale:
                    self.stop(f"its client was silent for {silent_s:.1f} s")
                elif now is not None:
                    self._publish(now)
            except LitheError as error:  # the robot has ended, or was started again
                with self._lock:
                    self._now, self._why = None, str(error)
            time.sleep(PERIOD_NS * 1e-9)

    def _publish(self, now: Reference) -> None:
        if now.ends and time.monotonic_ns() - now.since_ns > 1e9 * COAST_S:
            with self._lock:
                self._now = None if self._now is now else self._now
            return
        first = (time.monotonic_ns() // PERIOD_NS + 1) * PERIOD_NS
        times = [first + i * PERIOD_NS for i in range(POINTS)]
        limits = self.limits()
        self._robot.publish(times, np.clip(now.at(times), limits.least_rad, limits.most_rad))
