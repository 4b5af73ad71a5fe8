# SPDX-License-Identifier: Apache-2.0
"""What the Spine decided about plans: the answer to a plan's id, from a record of its own in shared memory.

Threads: may be shared. Times are CLOCK_MONOTONIC nanoseconds.
"""

from __future__ import annotations

import math
import threading
import time
from typing import Any

import numpy.typing as npt

from ._wire import NJ, SEGMENTS, Mode, PlanReject
from .errors import Refused
from .shm import RingCursor, SpineView

OTHER_CLOCK_S = 1.0  # a clock that is so far from the Spine's is another one, and not late
MOST_TURNS_RAD = 4 * math.pi  # an angle beyond it is probably in degrees
TURN_RAD = 1.0  # a way that is so near 2 pi is probably a jump from one turn to the next
_TICKS_WITHIN_S = 0.05
_NEXT = {
    PlanReject.count: "publish 1 to 16 waypoints",
    PlanReject.joints: "give each waypoint one angle for each joint: robot.spine.joint_names",
    PlanReject.not_finite: "look for a division by 0 or a missing value in the plan: numpy.isfinite()",
    PlanReject.time_order: "sort the waypoints by time; no two may have the same time",
    PlanReject.too_far: "publish at most the next 10 s, and the rest later",
    PlanReject.too_old: "plan ahead: the last waypoint after time.monotonic_ns(), the first at most 10 s before it; "
    "with interpolation hold the last may be as old as [brain] stale_after_s",
    PlanReject.position_limit: "keep every waypoint within the joint's limits: robot.spine.info['position_max_rad']",
}
_NEXT_IN_MODE = {
    Mode.estop: "when it is safe: reset, then arm, then ask for the motion again",
    Mode.safe_stop: "find the cause (status), then reset, arm, and ask for the motion again",
    Mode.recover: "wait until every joint is inside its limits, then arm, then ask for the motion again",
}


def refused_in(mode: Mode) -> Refused:
    """A plan in a mode in which none is followed."""
    next_step = _NEXT_IN_MODE.get(mode, "arm, then ask for the motion again")
    return Refused("refused_mode", f"in mode {mode.name} no plan is followed", next_step)


class Decisions:
    """The last 4096 of them, by plan id. Ids are compared for equality only: another Brain's may be larger."""

    def __init__(self, spine: SpineView) -> None:
        self._spine = spine
        self._lock = threading.Lock()
        self._cursor = RingCursor(spine.mapping, "plan_decisions", from_oldest=True)
        self._by_id: dict[int, npt.NDArray[Any]] = {}

    def of(self, plan_id: int) -> npt.NDArray[Any] | None:
        """The record (PlanDecision); None: no tick has decided about this plan yet, or that is too long ago."""
        with self._lock:
            self._by_id |= {int(record["plan_id"]): record for record in self._cursor.drain()}
            for oldest in list(self._by_id)[: -SEGMENTS["spine"]["plan_decisions"].depth]:
                del self._by_id[oldest]
            return self._by_id.get(plan_id)

    def refusal(self, decision: npt.NDArray[Any]) -> Refused | None:
        """The error to raise for it; None: the plan is followed."""
        reason = PlanReject(int(decision["reject"]))
        if reason == PlanReject.none:
            return None
        if reason == PlanReject.mode:
            return refused_in(Mode(int(decision["value"])))
        why = bytes(decision["text"]).decode(errors="replace")
        names = ("joint", "waypoint", "value", "limit", "way_rad", "needs_s")
        numbers = {name: decision[name].item() for name in names}
        if numbers["joint"] == NJ:
            del numbers["joint"]
        detail = {"reason": reason.name, "decided_ns": int(decision["t_ns"]), **numbers}
        message = f"the Spine refused the plan: {why}"
        return Refused("refused_plan", message, self._next_step(reason, numbers), detail)

    def _next_step(self, reason: PlanReject, numbers: dict[str, Any]) -> str:
        if reason in (PlanReject.too_old, PlanReject.too_far):
            return other_clock(clock_ahead_s(self._spine)) or _NEXT[reason]
        if reason == PlanReject.position_limit and abs(numbers["value"]) > MOST_TURNS_RAD:
            return f"angles are in radians: {numbers['value']:g} degrees are {math.radians(numbers['value']):.3f}"
        if reason != PlanReject.velocity_limit:
            return _NEXT[reason]
        if numbers["needs_s"] == 0:
            return f"give velocities of at most {numbers['limit']:.3f} rad/s"
        least_s = math.ceil(numbers["needs_s"] * 100 + 1) / 100  # and 10 ms on the way to the Spine
        turn = "; it is near a full turn: if the angle jumped by 2 pi, numpy.unwrap mends it"
        jumped = abs(abs(numbers["way_rad"]) - 2 * math.pi) < TURN_RAD
        return f"give this way at least {least_s:.2f} s, or plan a smaller step{turn if jumped else ''}"


def clock_ahead_s(spine: SpineView) -> float:
    """How far the Spine's CLOCK_MONOTONIC is ahead of this process's [s]; 0 while it does not tick."""
    before = int(spine.mapping.header().heartbeat_ns)
    until = time.monotonic() + _TICKS_WITHIN_S
    while (now := int(spine.mapping.header().heartbeat_ns)) == before:
        if time.monotonic() > until:
            return 0.0
        time.sleep(0.001)
    return (now - time.monotonic_ns()) * 1e-9


def other_clock(ahead_s: float) -> str:
    """What to do when that is another clock; empty when it is the same."""
    if abs(ahead_s) < OTHER_CLOCK_S:
        return ""
    way = "behind" if ahead_s > 0 else "ahead of"
    return (
        f"this process's CLOCK_MONOTONIC is {abs(ahead_s):.1f} s {way} the Spine's: it has another time namespace "
        "(a container, unshare -T); start it in the robot's"
    )
