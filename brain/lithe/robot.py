# SPDX-License-Identifier: Apache-2.0
"""A running robot as the Brain sees it: telemetry and plans through shared memory, verbs through the supervisor.

Threads: one Robot per thread, but for `call` and the verbs, which may be shared. Times are CLOCK_MONOTONIC nanoseconds
(`time.monotonic_ns()`) or seconds from now where a name ends in `_s`; angles are radians in joint order.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from . import place
from ._wire import Mode
from .control import connect_control, find_robot
from .errors import LitheError, Refused
from .shm import BrainWriter, SpineView


class Telemetry:
    """What the Spine measured, as private numpy copies. One record has the fields of message Telemetry."""

    def __init__(self, spine: SpineView) -> None:
        self._spine = spine
        self._cursor = spine.telemetry()

    def latest(self) -> npt.NDArray[Any] | None:
        """The newest record, None before the first tick."""
        return self._cursor.latest()

    def drain(self) -> npt.NDArray[Any]:
        """All records since the last drain, oldest first."""
        return self._cursor.drain()

    @property
    def lost(self) -> int:
        """Records that drain() came too late for (the ring holds 4096)."""
        return self._cursor.lost

    def history(self, seconds: float) -> npt.NDArray[Any]:
        """The last `seconds` of records, as far as the ring reaches back (4096 ticks)."""
        records = self._spine.telemetry(from_oldest=True).drain()
        if len(records) == 0:
            return records
        recent: npt.NDArray[Any] = records[records["release_ns"] > records["release_ns"][-1] - int(seconds * 1e9)]
        return recent


class Params:
    """Live parameters of the running law: `robot.params["kp_nm_rad"] = 8.0`, or several at once with set()."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    def get(self) -> dict[str, dict[str, float]]:
        """Name -> {value, min, max}."""
        answer = self._robot.call("params")
        return {entry["name"]: {key: entry[key] for key in ("value", "min", "max")} for entry in answer["params"]}

    def set(self, **values: float) -> Any:
        """Sets all of them on one tick, or none."""
        return self._robot.call("set_params", values=values)

    def __getitem__(self, name: str) -> float:
        params = self.get()
        if name not in params:
            raise LitheError(f"the running law has no parameter '{name}'\n  next: one of {', '.join(params)}")
        return params[name]["value"]

    def __setitem__(self, name: str, value: float) -> None:
        self.set(**{name: value})


class Robot:
    """Made by lithe.connect()."""

    def __init__(self, name: str, writes_plans: bool = True) -> None:
        self.name = name
        self._control = connect_control(name)
        try:
            self.spine = SpineView(name)
            self._writer = BrainWriter(name) if writes_plans else None
        except LitheError:
            self._control.close()
            raise
        self._plan_id = time.monotonic_ns()  # grows from run to run too
        self.telemetry = Telemetry(self.spine)
        self.params = Params(self)
        info = self.spine.info
        if int(info["cpu_brain"]) != int(info["cpu_spine"]):
            place.pin(int(info["cpu_brain"]))
        place.warn_if_late()

    # ---- motion
    def publish(
        self,
        t_ns: npt.ArrayLike,
        position_rad: npt.ArrayLike,
        velocity_rad_s: npt.ArrayLike | None = None,
        streaming: bool = True,
    ) -> int:
        """Publishes a horizon of up to 16 waypoints at absolute times, and a sign of life; returns the plan's id.

        t_ns (n,) strictly ascending; position_rad (n, joints) or (n,) for one joint; velocity likewise, None = the
        Spine chooses. streaming: more will follow, so the last waypoint is passed and not stopped at.
        """
        if self._writer is None:
            raise LitheError("this connection only looks\n  next: lithe.connect(writes_plans=True)")
        self._plan_id += 1
        position = np.asarray(position_rad, dtype=np.float64)
        velocity = None if velocity_rad_s is None else np.asarray(velocity_rad_s, dtype=np.float64)
        if position.ndim == 1:
            position = position[:, None]
            velocity = None if velocity is None else velocity.reshape(position.shape)
        self._writer.publish(self._plan_id, t_ns, position, velocity, streaming)
        return self._plan_id

    def go_to(self, position_rad: npt.ArrayLike, in_s: float) -> int:
        """Moves to a position, arriving `in_s` from now and resting there."""
        return self.publish(
            [time.monotonic_ns() + int(in_s * 1e9)], np.atleast_2d(np.asarray(position_rad)), streaming=False
        )

    def beat(self) -> None:
        """A sign of life without a plan."""
        if self._writer is not None:
            self._writer.beat()

    # ---- laws
    def swap(self, law: str | Path, name: str | None = None, params: dict[str, float] | None = None) -> dict[str, Any]:
        """Replaces the running law by C++ source text or a file; returns the transaction's record.

        Raises Refused, with the compiler's diagnostics in `detail`, and the old law runs on.
        """
        text = str(law)
        if isinstance(law, Path) or (text.endswith(".cpp") and "\n" not in text):
            name = name or Path(text).name
            try:
                text = Path(text).read_text(encoding="utf-8")
            except OSError as error:
                raise LitheError(f"cannot read the law {text}: {error.strerror}") from None
        args: dict[str, Any] = {"source": text, "name": name or "law.cpp", "params": params or {}}
        result: dict[str, Any] = self.call("swap", **args)
        return result

    def rollback(self) -> Any:
        """Back to the previous law."""
        return self.call("rollback")

    # ---- verbs
    def call(self, verb: str, /, **args: Any) -> Any:
        """Any verb of the control socket."""
        return self._control.call(verb, args)

    def status(self) -> dict[str, Any]:
        result: dict[str, Any] = self.call("status")
        return result

    def events(self, since: int = 0) -> Any:
        return self.call("events", since=since)

    def arm(self) -> Any:
        return self.call("arm")

    def disarm(self) -> Any:
        return self.call("disarm")

    def hold(self) -> Any:
        return self.call("hold")

    def reset(self) -> Any:
        """After a fault or an e-stop; releases the Brain's own e-stop word first, which nobody else can."""
        if self._writer is not None:
            self._writer.press_estop(False)
        return self.call("reset")

    def estop(self, within_s: float = 0.5) -> dict[str, Any]:
        """At once, through shared memory: needs no supervisor. Returns when a tick has obeyed.

        Refused with code "robot_fault" when none has within `within_s`; the word stays pressed.
        """
        if self._writer is None:
            result: dict[str, Any] = self.call("estop")
            return result
        self._writer.press_estop()
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
        self._control.close()
        if self._writer is not None:
            self._writer.close()

    def __enter__(self) -> Robot:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def connect(robot: str | None = None, writes_plans: bool = True) -> Robot:
    """Connects to a running robot (the only one, if no name is given) and pins this process to the Brain's core."""
    return Robot(robot or find_robot(), writes_plans)
