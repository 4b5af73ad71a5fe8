# SPDX-License-Identifier: Apache-2.0
"""References that are streamed to the Spine as plans: rest, steps, sine, multisine, chirp, waypoints.

A reference is checked against the joints' limits before it starts, and begins where the joints are, with the speed of
the setpoint. It ends at rest: when it is stopped, and when the client that set it has left or been silent for too long.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .._wire import Mode, PlanReject
from ..errors import LitheError, Refused
from ..robot import Robot
from .curves import Args, Curve, Vector, curve_of

PERIOD_NS = 20_000_000  # between two points of a plan
POINTS = 12
COAST_S = 0.5  # from the setpoint's speed to rest
FAR_RAD = 0.1  # a setpoint that far from its joint is not where the joint is
USUAL_RAMP_S = 1.0
PIECE_S = 60.0  # of a reference, checked at a time in steps of CHECK_STEP_S
CHECK_STEP_S = 0.005
ROUNDING_RAD = 1e-9
MOST_REFUSED = 3  # plans in a row; a single one may have come late
_RESTS: dict[str, Any] = {"kind": "rest"}
_OF_ALL = ("stay", "client_stale_s", "ramp_s")  # arguments of every kind


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

    curve: None: it comes to rest.
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


def least_ramp_s(curve: Curve, start_rad: Vector, limits: Limits) -> float:
    """A time [s] to fade in that takes at most half of each joint's speed limit; a minimum jerk peaks at 15/8."""
    way_rad = np.abs(curve(np.arange(0.0, PIECE_S, CHECK_STEP_S, dtype=np.float64)) - start_rad).max(axis=0)
    return float(np.max(15 / 8 * way_rad / (0.5 * limits.speed_rad_s)))


def check(reference: Reference, limits: Limits) -> None:
    """Raises Refused where it leaves a joint's range or is too fast, whenever that is: joint, value, limit, time."""
    curve, whole_s = reference.curve, max(reference.ramp_s, COAST_S)
    if curve is not None and not _swings_within(curve, limits):
        whole_s += curve.whole_s
    for begin_s in np.arange(0.0, whole_s, PIECE_S).tolist():
        end_s = min(begin_s + PIECE_S, whole_s) + CHECK_STEP_S  # the first point of the next piece, too: for its speed
        _check_piece(reference, limits, np.arange(begin_s, end_s + CHECK_STEP_S, CHECK_STEP_S, dtype=np.float64))


def _swings_within(curve: Curve, limits: Limits) -> bool:
    if curve.swings is None:
        return False
    centre, most, speed = curve.swings
    inside = (centre + most <= limits.most_rad) & (centre - most >= limits.least_rad)
    return bool((inside & (speed <= limits.speed_rad_s)).all())


def _check_piece(reference: Reference, limits: Limits, t_s: Vector) -> None:
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
        self._publishing = threading.Lock()  # one plan at a time; taken before `_lock`
        self._now: Reference | None = None
        self._owner: object = None
        self._stale_s = math.inf
        self._heard_ns = 0
        self._why = "none was set"
        self._until_ns = 0  # the last point that was published
        self._interruptions = 0  # of the reference that was set last, and how long they were together
        self._lost_s = 0.0
        self._thread: threading.Thread | None = None

    def limits(self) -> Limits:
        """Those of the robot."""
        spine = self._robot.spine
        each = {name: np.array(spine.info[name][: spine.joint_count], dtype=np.float64)
                for name in ("position_min_rad", "position_max_rad", "velocity_max_rad_s")}  # fmt: skip
        return Limits(
            list(spine.joint_names), each["position_min_rad"], each["position_max_rad"], each["velocity_max_rad_s"]
        )

    def set(self, args: dict[str, Any], owner: object = None, dry_run: bool = False) -> dict[str, Any]:
        """Starts a reference: `kind` and its arguments (docs/agents.md); returns what runs. Refused when it would leave
        a limit, and when the Spine does not follow it: then the one before goes on.

        stay: it goes on without its client. client_stale_s: without it, it ends after this time without a word.
        dry_run: it is only checked; returns its ramp_s.
        """
        joints = self._robot.spine.joint_count
        kind, stay = str(args.get("kind", "")), bool(args.get("stay", False))
        given = Args({name: value for name, value in args.items() if name in _OF_ALL}, joints)
        stale_s = given.number("client_stale_s", 5.0, 0.1, 3600.0)
        ramp_s = given.number("ramp_s", USUAL_RAMP_S, 0.1, 60.0)
        own = {name: value for name, value in args.items() if name not in _OF_ALL}
        if kind == "rest":
            curve = None
            Args({name: value for name, value in own.items() if name != "kind"}, joints).end(kind)
        else:
            curve = curve_of(own, joints)
        start_rad, speed_rad_s = self._where(curve is None)
        limits = self.limits()
        if curve is not None:
            ramp_s = max(ramp_s, least_ramp_s(curve, start_rad, limits))
        made = Reference(time.monotonic_ns(), start_rad, speed_rad_s, curve, ramp_s, dict(args))
        check(made, limits)
        if dry_run:
            return {"ramp_s": round(ramp_s, 3)}
        with self._publishing:
            self._begin(made)
            with self._lock:
                self._now, self._owner, self._why = made, owner, ""
                self._interruptions, self._lost_s = 0, 0.0
                self._stale_s = math.inf if stay else stale_s
                self._heard_ns = time.monotonic_ns()
                if self._thread is None:
                    self._thread = threading.Thread(target=self._run, name="lithe-references", daemon=True)
                    self._thread.start()
        note = f"it ends when this client sends no request for {stale_s:g} s (client_stale_s), or leaves (stay)"
        return self.told() | ({} if stay else {"note": note})

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
        """`asked` (as it was set; kind rest: none), since_ns, and why the one before ended; how often and how long
        since it was set its points came too late (`interruptions`, `lost_s`), so that the setpoint slowed down.
        """
        with self._lock:
            now = self._now
            return {
                "asked": dict(now.asked) if now else dict(_RESTS),
                "since_ns": now.since_ns if now else 0,
                "ramp_s": now.ramp_s if now else 0.0,
                "streams": now is not None,
                "ended": self._why,
                "interruptions": self._interruptions,
                "lost_s": round(self._lost_s, 3),
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

    def _begin(self, made: Reference) -> None:
        refused: Refused | None = None
        for _ in range(MOST_REFUSED):
            refused = self._refused(self._publish(made))
            if refused is None:
                return
        assert refused is not None
        raise refused

    def _run(self) -> None:
        plan_id = in_a_row = 0
        while True:
            with self._publishing:
                with self._lock:
                    now = self._now
                    silent_s = 1e-9 * (time.monotonic_ns() - self._heard_ns)
                    stale = now is not None and silent_s > self._stale_s
                try:
                    if stale:
                        self.stop(f"its client was silent for {silent_s:.1f} s")
                    elif now is not None:
                        refused = self._refused(plan_id)
                        # One that came too late says nothing of the next: the machine was busy.
                        late = refused is not None and PlanReject.too_old.name in refused.message
                        in_a_row = in_a_row + 1 if refused and not late else 0
                        if refused and in_a_row >= MOST_REFUSED:
                            self._give_up(now, refused)
                            plan_id = in_a_row = 0
                        else:
                            plan_id = self._publish(now)
                except LitheError as error:  # the robot has ended, or was started again
                    with self._lock:
                        self._now, self._why = None, str(error)
            time.sleep(PERIOD_NS * 1e-9)

    def _refused(self, plan_id: int) -> Refused | None:
        """Why the Spine does not follow that plan; None: it does, or has not looked yet, or there is none (0)."""
        try:
            if plan_id != 0:
                self._robot.decided(plan_id)
        except Refused as refused:
            return refused
        return None

    def _give_up(self, now: Reference, refused: Refused) -> None:
        if not now.ends and refused.code != "refused_mode":  # it moves still
            self.stop(refused.message)
            return
        with self._lock:
            if self._now is now:
                self._now, self._why = None, self._why if now.ends else refused.message

    def _publish(self, now: Reference) -> int:
        """The next points; the plan's id, 0 when there was none to publish."""
        if now.ends and time.monotonic_ns() - now.since_ns > 1e9 * COAST_S:
            with self._lock:
                self._now = None if self._now is now else self._now
            return 0
        first = (time.monotonic_ns() // PERIOD_NS + 1) * PERIOD_NS
        times = [first + i * PERIOD_NS for i in range(POINTS)]
        limits = self.limits()
        plan_id = self._robot.publish(times, np.clip(now.at(times), limits.least_rad, limits.most_rad))
        with self._lock:
            late_s = 1e-9 * (time.monotonic_ns() - self._until_ns)
            if now is self._now and now.curve is not None and late_s > 0:
                self._interruptions, self._lost_s = self._interruptions + 1, self._lost_s + late_s
            self._until_ns = times[-1]
        return plan_id
