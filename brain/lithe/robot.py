# SPDX-License-Identifier: Apache-2.0
"""A running robot: telemetry and plans through shared memory, verbs through the supervisor.

Threads: a Robot may be shared. Times are CLOCK_MONOTONIC nanoseconds (`time.monotonic_ns()`), or seconds from now where
a name ends in `_s`; angles are radians in joint order.
"""

from __future__ import annotations

import logging
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from . import mailbox, place
from ._wire import Mode
from .control import connect_control, find_robot
from .decisions import Decisions, clock_ahead_s, other_clock
from .errors import LitheError, NoSupervisor, NotRunning, Refused
from .files import read_regular
from .heartbeat import Heartbeat, period_s
from .shm import BrainWriter, SpineView
from .telemetry import Telemetry
from .values import Inputs, Params

_log = logging.getLogger("lithe")


class Robot:
    """Made by lithe.connect(). `name` is the robot's, `spine` the data of its Spine (lithe.shm.SpineView)."""

    def __init__(self, name: str, writes_plans: bool = True, heartbeat: bool = True) -> None:
        self.name = name
        self._lock = threading.RLock()  # plans leave in the order of their ids; one reconnect at a time
        self._beats_itself = heartbeat
        self._heartbeat: Heartbeat | None = None
        self._writer: BrainWriter | None = None
        self._closed = False
        self._plan_id = time.monotonic_ns()  # grows from run to run too
        self._control = connect_control(name, may_be_absent=mailbox.ticks_alone(name))
        try:
            self.spine = SpineView(name)
            info = self.spine.info
            if int(info["cpu_brain"]) != int(info["cpu_spine"]):
                place.pin(int(info["cpu_brain"]))
            if writes_plans:
                self._take_the_brain()
        except LitheError:
            self._control.close()
            raise
        self.telemetry = Telemetry(self.spine)
        self._decisions = Decisions(self.spine)
        self.params = Params(self)
        self.inputs = Inputs(self)
        place.warn_if_late()
        if writes_plans and (words := other_clock(clock_ahead_s(self.spine))):
            _log.warning("plans and heartbeats of this Brain have wrong times: %s", words)

    def _take_the_brain(self) -> None:
        self._writer = BrainWriter(self.name)
        if self._beats_itself:
            robot_file = Path(bytes(self.spine.info["config_path"]).decode(errors="replace"))
            self._heartbeat = Heartbeat(self._writer.beat, period_s(robot_file))

    def _leave_the_brain(self) -> None:
        if self._heartbeat is not None:
            self._heartbeat.stop()
            self._heartbeat = None
        if self._writer is not None:
            self._writer.close()

    # ---- the robot at the other end
    @property
    def attached(self) -> bool:
        """False once the robot has ended or was started again, or after close(): then reconnect()."""
        return not self._closed and self.spine.mapping.is_current()

    def reconnect(self) -> None:
        """Attaches to the robot after it was started again; does nothing if it is still the same run.

        Verbs need no reconnect(): they find a new supervisor by themselves. Plans and telemetry need it, because the
        new run counts its ticks from zero, and may have other positions and joints: check them before you publish.
        Raises LitheError while no robot of that name runs: try again later.
        """
        with self._lock:
            if self._closed:
                raise LitheError("this connection was closed\n  next: lithe.connect()")
            if self.attached:
                return
            spine = SpineView(self.name)
            writes_plans = self._writer is not None
            self._leave_the_brain()
            self.spine, old = spine, self.spine
            try:
                if writes_plans:
                    self._take_the_brain()
            except LitheError:
                self.spine = old
                raise
            self.telemetry._attach(spine)
            self._decisions = Decisions(spine)

    def _check(self) -> BrainWriter:
        if self._writer is None:
            raise LitheError("this connection only looks\n  next: lithe.connect(writes_plans=True)")
        if not self.attached:
            raise NotRunning(
                f"robot '{self.name}' has ended, or was started again, or this connection was closed\n"
                "  next: robot.reconnect(), once it runs"
            )
        return self._writer

    # ---- motion
    def publish(
        self,
        t_ns: npt.ArrayLike,
        position_rad: npt.ArrayLike,
        velocity_rad_s: npt.ArrayLike | None = None,
        streaming: bool = True,
        interpolation: str = "cubic",
    ) -> int:
        """Publishes up to 16 waypoints at absolute times, and a heartbeat; returns the plan's id.

        t_ns (n,) in CLOCK_MONOTONIC ns, strictly ascending; position_rad (n, joints), or (n,) for one joint;
        velocity_rad_s likewise, None = the Spine chooses. streaming: more plans will follow, so the last waypoint is
        passed without a stop. Arrays of wrong shapes raise BadPlan.

        interpolation "hold" (zero-order hold, for policies and teleoperation): the setpoint steps to each waypoint at
        its time and stays there, with velocity_rad_s, else 0. A time that has passed steps at once: publish([now_ns],
        [target_rad], interpolation="hold"). Steps may be of any size within the position limits.

        When the Spine refuses a plan (a limit, a time long
        past), it continues the plan before; decided() says so.
        """
        position = np.asarray(position_rad, dtype=np.float64)
        velocity = None if velocity_rad_s is None else np.asarray(velocity_rad_s, dtype=np.float64)
        if position.ndim == 1:
            position = position[:, None]
            velocity = velocity[:, None] if velocity is not None and velocity.ndim == 1 else velocity
        with self._lock:
            writer = self._check()
            writer.publish(self._plan_id + 1, t_ns, position, velocity, streaming, interpolation)
            self._plan_id += 1
            return self._plan_id

    def decided(self, plan_id: int, wait_s: float = 0.1) -> bool:
        """What the Spine made of a plan: True when it follows it, or followed it before a newer one took its place.

        Refused with the reason when it does not: `refused_mode` (it follows plans in mode active only), `refused_plan`
        (`detail`: reason, joint, waypoint, value, limit). False when no tick has decided about it within wait_s: the
        Spine is late, a newer plan came before it looked, or more than 4096 plans came since.
        """
        end_s = time.monotonic() + wait_s
        while (decision := self._decisions.of(plan_id)) is None:
            if not self.attached:
                raise NotRunning(f"robot '{self.name}' has ended, or was started again\n  next: robot.reconnect()")
            if time.monotonic() >= end_s:
                return False
            time.sleep(0.001)
        if (refusal := self._decisions.refusal(decision)) is not None:
            raise refusal
        return True

    def go_to(self, position_rad: npt.ArrayLike, in_s: float) -> int:
        """Moves to a position (joints,), arriving `in_s` seconds from now and resting there; returns the plan's id."""
        return self.publish(
            [time.monotonic_ns() + int(in_s * 1e9)], np.atleast_2d(np.asarray(position_rad)), streaming=False
        )

    def beat(self) -> None:
        """A heartbeat without a plan, for a Brain connected with heartbeat=False. Does not block."""
        if self._writer is not None and self.attached:
            self._writer.beat()

    # ---- laws
    def swap(
        self, law: str | Path, name: str | None = None, params: dict[str, float] | None = None, **terms: float
    ) -> dict[str, Any]:
        """Replaces the running law by C++ source text or a file; returns the certificate.

        Raises Refused, with the compiler's diagnostics in `detail`; the old law continues.

        terms replace those of the robot file: blend_s (from the old torque to the new one's), probation_s
        (automatic rollback during this time; 0 = none), error_ratio (how much worse tracking may get),
        shadow_s (run beside the active law first) with shadow_tolerance_nm and promote (False: it is only compared,
        and never runs), budget_us (of a step), box_ms (of a trial).
        """
        text = str(law)
        if isinstance(law, Path) or (text.endswith(".cpp") and "\n" not in text):
            name = name or Path(text).name
            try:
                text = read_regular(text)
            except (OSError, ValueError) as error:
                why = error.strerror if isinstance(error, OSError) else error
                raise LitheError(f"cannot read the law {text}: {why}\n  next: give the path of one C++ file") from None
        args: dict[str, Any] = {"source": text, "name": name or "law.cpp", "params": params or {}, **terms}
        result: dict[str, Any] = self.call("swap", **args)
        return result

    def rollback(self, steps: int = 1) -> Any:
        """Goes back by 1 to 4 laws, to one that is still in the Spine, with its last state."""
        return self.call("rollback", steps=steps)

    def activate(self, law: str) -> Any:
        """Goes back to an earlier law by its name, as rollback() does by steps; nothing changes if it runs already."""
        return self.call("activate", law=law)

    # ---- verbs
    def call(self, verb: str, /, **args: Any) -> Any:
        """Any verb of the control socket.

        While no supervisor lives but the Spine ticks, arm, disarm, hold, reset, rollback, set_params and revert_params
        go through shared memory instead, `params` is read there; the answers have `"via": "mailbox"`, and a warning is
        logged. Other verbs raise NotRunning.
        """
        try:
            return self._control.call(verb, args)
        except NoSupervisor as absent:
            return self._call_spine(verb, args, absent)

    def _call_spine(self, verb: str, args: dict[str, Any], absent: NoSupervisor) -> Any:
        if not self.attached or not self.spine.is_alive():
            raise absent
        if mailbox.supervisor_lives(self.name):
            raise NotRunning(
                f"robot '{self.name}' does not answer, but its supervisor lives\n"
                "  next: is it starting? has it another LITHE_RUN_DIR?"
            )
        if verb == "params":  # nothing to send
            return mailbox.params_of(self.spine)
        if verb not in mailbox.VERBS:
            raise NotRunning(
                f"robot '{self.name}' has no supervisor, and '{verb}' needs one; its Spine ticks on\n"
                f"  next: lithe run ROBOT.toml adopts it; without one: {', '.join(mailbox.VERBS)}"
            )
        _log.warning("no supervisor of '%s' lives: '%s' goes through shared memory", self.name, verb)
        return mailbox.Mailbox(self.spine, self._check()).call(verb, args)

    def state(self) -> dict[str, Any]:
        """The running law's State, name -> number or numpy array, all of one tick, at most 10 ms old.

        Empty when the law has none. Read from shared memory: costs the Spine nothing and needs no supervisor.
        """
        if not self.attached:
            raise NotRunning(f"robot '{self.name}' has ended, or was started again\n  next: robot.reconnect()")
        return self.spine.state()

    def status(self) -> dict[str, Any]:
        """Mode, fault, law, lost ticks, time quantiles, joints with their problems: what `lithe --json status` has."""
        result: dict[str, Any] = self.call("status")
        return result

    def events(self, since: int = 0) -> Any:
        """{"events": [...], "cursor": n, "lost": n}: what happened after the cursor `since`, the newest last."""
        return self.call("events", since=since)

    def arm(self, all_the_same: bool = False) -> Any:
        """Torque on: the law runs from the next tick. A law that has stopped the robot only with `all_the_same`."""
        return self.call("arm", **({"all_the_same": True} if all_the_same else {}))

    def disarm(self, now: bool = False) -> Any:
        """Torque off, once a moving joint has been braked to rest; with `now` at once. `what` of the answer says it."""
        return self.call("disarm", now=now)

    def hold(self) -> Any:
        """The setpoint slows down and stops; the running law continues to track it, until arm()."""
        return self.call("hold")

    def reset(self) -> Any:
        """Clears a fault or an e-stop; first clears the Brain's own e-stop word, which only the Brain can clear."""
        if self._writer is not None and self.attached:
            self._writer.press_estop(False)
        return self.call("reset")

    def recover(self, within_s: float = 120.0) -> dict[str, Any]:
        """Brings joints that are outside their limits inside: slowly, with little torque, without a law.

        Returns the status once every joint is inside; it is held there until arm() or disarm(). When it fails,
        it is refused with the Spine's fault as code (`recover_failed`: a joint does not move, or its load is too
        large), and with `timeout` after `within_s`; the Spine continues then.
        """
        self.call("recover")
        until = time.monotonic() + within_s
        while time.monotonic() < until:
            status = self.status()
            if status["mode"] != "recover":
                stops = [event["text"] for event in self.events()["events"] if event["kind"] == "safe_stop"]
                why = stops[-1] if stops and status["mode"] == "safe_stop" else f"mode {status['mode']}"
                code = status["fault"] if status["mode"] == "safe_stop" else "refused_mode"
                raise Refused(code, f"not recovered: {why}", "see joints and events: robot.status(), robot.events()")
            if not status["recovering"]:
                return status
            time.sleep(0.05)
        raise Refused("timeout", f"not every joint is inside after {within_s:g} s", "it goes on: robot.status()")

    def sim_reset(self) -> Any:
        """Puts the joints back to their start positions; only for a disarmed robot whose buses are all simulated."""
        return self.call("sim_reset")

    def estop(self, within_s: float = 0.5) -> dict[str, Any]:
        """At once, through shared memory: needs no supervisor. Returns after a tick has seen it.

        Refused with code "robot_fault" when no tick has within `within_s`; the word stays set. If the robot was
        started again, the new run is stopped.
        """
        if self._writer is None:
            result: dict[str, Any] = self.call("estop")
            return result
        with self._lock:
            self.reconnect()
            self._check().press_estop()
        until = time.monotonic() + within_s
        while time.monotonic() < until:
            record = self.spine.latest()
            if record is not None and int(record["mode"]) == Mode.estop:
                return {"mode": "estop", "tick": int(record["tick"])}
            time.sleep(0.001)
        raise Refused(
            "robot_fault",
            f"the Spine of '{self.name}' has not obeyed the e-stop within {within_s:g} s",
            "its drives' watchdogs stop the robot; if it moves, cut its power",
        )

    def close(self) -> None:
        """Ends the heartbeat and frees the robot for the next Brain; may be called twice."""
        with self._lock:
            self._closed = True
            self._leave_the_brain()
        self._control.close()

    def __enter__(self) -> Robot:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def connect(robot: str | None = None, writes_plans: bool = True, heartbeat: bool = True) -> Robot:
    """Connects to a running robot (the only one, if no name is given) and pins this thread to the Brain's core.

    writes_plans: act as the robot's Brain, of which there can be only one; False: read and call verbs only.

    heartbeat: a thread tells the Spine that this Brain lives, five times within the robot's `stale_after_s`. A Brain
    that is killed, stopped or closed sends no heartbeat, and the Spine then does what `on_stale` says. But a thread
    proves only that the process lives; a main loop that hangs is not detected. A Brain that publishes from a loop
    should use False; then only publish() and beat() count, and a pause longer than `stale_after_s` ends the plan.
    """
    return Robot(robot or _the_robot(), writes_plans, heartbeat)


def _the_robot() -> str:
    """The one robot here: with a supervisor, else the one whose Spine ticks without."""
    try:
        return find_robot()
    except NotRunning:
        alone = mailbox.robots_alone()
        if not alone:
            raise
        if len(alone) > 1:
            raise LitheError(
                f"several robots tick here without a supervisor: {', '.join(alone)}\n"
                f"  next: lithe.connect('{alone[0]}')"
            ) from None
        return alone[0]
