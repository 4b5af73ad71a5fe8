# SPDX-License-Identifier: Apache-2.0
"""Commands to the Spine through the Brain's own mailbox in shared memory, while no supervisor lives.

The Spine reads one command per tick and answers each; it checks them like the supervisor's.
Parameters are not tried before they are in force, and nothing is recorded: that needs a supervisor.
While a supervisor lives the Spine refuses parameters from this mailbox; its verb tries them.

Threads: may be shared. Errors: Refused, with the codes of the control socket.
"""

from __future__ import annotations

import fcntl
import os
import time
from numbers import Real
from typing import Any

import numpy as np
import numpy.typing as npt

from ._wire import NPARAM, CommandKind, CommandResult, Fault, Mode
from .errors import Refused, ShmError
from .shm import SAFELY, BrainWriter, SpineView, dtype, shm_path

ANSWER_S = 2.0  # as long as a supervisor waits
BRAKING_S = 4.0  # likewise, for a joint to come to rest before the drives are off
# What a moment may mend: drives that were off a moment ago; a supervisor that has just died, for which the Spine looks
# every 50 ms, from a thread that a busy machine may hold up.
AGAIN_S = {
    (CommandKind.arm, CommandResult.refused_not_ready): 0.2,
    (CommandKind.set_params, CommandResult.refused_untried): 1.5,
}
LOOK_S = 0.001
VIA = "mailbox"
VERBS = ("arm", "disarm", "hold", "reset", "rollback", "set_params", "revert_params")

_NEXT = {
    CommandResult.refused_mode: "after a fault or an e-stop: robot.reset(), then robot.arm()",
    CommandResult.refused_estop: "robot.reset() releases this Brain's e-stop; the supervisor's: lithe run, lithe reset",
    CommandResult.refused_fault: "find its cause, then: robot.reset(), robot.arm()",
    CommandResult.refused_law: "see which laws are there: robot.spine.laws(); a swap needs a supervisor: lithe run",
    CommandResult.refused_range: "nothing was changed; see the ranges: robot.params.get()",
    CommandResult.refused_not_ready: "try again; robot.telemetry.latest() has each joint's status",
    CommandResult.refused_not_homed: "home the joint, then: robot.arm()",
    CommandResult.refused_untried: "a supervisor lives: robot.params.set() asks it, and it tries them first",
    CommandResult.refused_marked: "its law has stopped the robot: robot.rollback(), or robot.arm(all_the_same=True)",
    CommandResult.refused_outside: "bring the joint inside by hand, or with a supervisor: lithe run, lithe recover",
}


def supervisor_lives(robot: str) -> bool:
    """Whether a process holds the supervisor's lease; also when this user may not look."""
    try:
        fd = os.open(f"{shm_path(robot, 'control')}.lock", os.O_RDWR | SAFELY)
    except PermissionError:
        return True
    except OSError:
        return False
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(fd)
    return False


def ticks_alone(robot: str) -> bool:
    """Whether the robot's Spine ticks and no supervisor lives."""
    try:
        return SpineView(robot).is_alive() and not supervisor_lives(robot)
    except ShmError:
        return False


def robots_alone() -> list[str]:
    """Robots of this user whose Spine ticks without a supervisor. Files of other users are ignored."""
    pattern = shm_path("*", "spine")
    before, after = pattern.name.split("*")
    ours = [path.name for path in pattern.parent.glob(pattern.name) if path.lstat().st_uid == os.geteuid()]
    return [name for name in sorted(each[len(before) : -len(after)] for each in ours) if ticks_alone(name)]


class Mailbox:
    """The verbs that need no supervisor: `VERBS`. Answers are those of the control socket and `"via": "mailbox"`."""

    def __init__(self, spine: SpineView, writer: BrainWriter) -> None:
        self._spine, self._writer = spine, writer

    def call(self, verb: str, args: dict[str, Any]) -> dict[str, Any]:
        """Sends one command, waits until a tick has handled it, and returns the answer."""
        if verb == "set_params":
            return self._set_params(**args)
        if verb == "rollback":
            return self._rollback(**args)
        answer = self._deliver(CommandKind[verb], int(bool(args.get("now") or args.get("all_the_same"))))
        if verb in ("disarm", "reset"):
            return self._off(answer)
        return params_of(self._spine) if verb == "revert_params" else answer

    def _deliver(
        self, kind: CommandKind, count: int = 0, law_id: int = 0, values: dict[int, float] | None = None
    ) -> dict[str, Any]:
        letter = np.zeros((), dtype("Command"))
        letter["kind"], letter["law_id"], letter["count"] = kind, law_id, count
        for at, (index, value) in enumerate((values or {}).items()):
            letter["index"][at], letter["value"][at], letter["count"] = index, value, at + 1
        from_s = time.monotonic()
        result = self._ask(kind, letter)
        while time.monotonic() - from_s < AGAIN_S.get((kind, result), 0):
            time.sleep(LOOK_S)
            result = self._ask(kind, letter)
        if result == CommandResult.done:
            answer = self._after_this_tick()
            if kind in (CommandKind.arm, CommandKind.hold) and answer["mode"] in ("safe_stop", "estop"):
                stopped = f"{kind.name} was done, and the robot is in {answer['mode']} at once: {answer['fault']}"
                raise Refused("refused_fault", stopped, _NEXT[CommandResult.refused_fault], answer)
            return answer
        where = self._where()
        message = f"cannot {kind.name} in mode {where['mode']} with fault {where['fault']}: {result.name}"
        raise Refused(result.name, message, _NEXT.get(result, "build both from the same source"))

    def _ask(self, kind: CommandKind, letter: npt.NDArray[Any]) -> CommandResult:
        ticket = self._writer.send(letter, self._spine)
        if ticket == 0:
            raise Refused("busy", "the Spine has sixteen unread commands", "try again; does it tick? robot.attached")
        until = time.monotonic() + ANSWER_S
        while time.monotonic() < until:
            if answer := self._spine.answer(ticket):
                return CommandResult(answer)
            time.sleep(LOOK_S)
        raise Refused(
            "timeout",
            f"{kind.name} is not confirmed: no answer within {ANSWER_S:g} s; it may still take effect",
            "see what the robot does: robot.telemetry.latest()",
        )

    def _where(self) -> dict[str, Any]:
        record = self._spine.latest()
        if record is None:
            return {"mode": Mode.disarmed.name, "fault": Fault.none.name, "tick": 0, "via": VIA}
        mode, fault = Mode(int(record["mode"])).name, Fault(int(record["fault"])).name
        return {"mode": mode, "fault": fault, "tick": int(record["tick"]), "via": VIA}

    def _after_this_tick(self) -> dict[str, Any]:
        """The tick that handled the command publishes its record after its answer."""
        first = self._where()
        until = time.monotonic() + ANSWER_S
        while (now := self._where())["tick"] <= first["tick"] and time.monotonic() < until:
            time.sleep(LOOK_S)
        return now

    def _off(self, answer: dict[str, Any]) -> dict[str, Any]:
        """Once the Spine has braked a joint that moved."""
        from_s = time.monotonic()
        while answer["mode"] == Mode.safe_stop.name and time.monotonic() < from_s + BRAKING_S:
            time.sleep(LOOK_S)
            answer = {**self._where(), "what": f"braked for {time.monotonic() - from_s:.2f} s"}
        return answer

    def _set_params(self, values: Any = None, name: str | None = None, value: Any = None, **_: Any) -> dict[str, Any]:
        values = {name: value} if name is not None else values
        if not isinstance(values, dict) or not 0 < len(values) <= NPARAM:
            raise Refused("usage", "no parameter was given", "robot.params.set(NAME=VALUE)")
        live = params_of(self._spine)
        entries = {entry["name"]: (index, entry) for index, entry in enumerate(live["params"])}
        chosen: dict[int, float] = {}
        for each, wanted in values.items():
            if each not in entries:
                known = f"it has: {', '.join(entries)}" if entries else "it has none"
                raise Refused("unknown_param", f"law '{live['law']}' has no parameter '{each}'", known)
            index, entry = entries[each]
            is_number = isinstance(wanted, Real) and not isinstance(wanted, bool)
            if not is_number or not entry["min"] <= float(wanted) <= entry["max"]:
                raise Refused(
                    "refused_range",
                    f"{each} = {wanted} is outside [{entry['min']:g}, {entry['max']:g}]",
                    "nothing was changed; choose a value inside the range",
                )
            chosen[index] = float(wanted)
        self._deliver(CommandKind.set_params, law_id=live["law_id"], values=chosen)
        return params_of(self._spine)

    def _rollback(self, steps: Any = 1, **_: Any) -> dict[str, Any]:
        if isinstance(steps, bool) or not isinstance(steps, int) or not 1 <= steps <= 4:
            raise Refused("usage", f"steps = {steps}: how many laws back, 1 to 4", "see which are there: spine.laws()")
        answer = self._deliver(CommandKind.rollback, steps)
        law = self._spine.running_law()
        return answer if law is None else {**answer, "law": name_of(law), "law_id": int(law["law_id"])}


def name_of(law: npt.NDArray[Any]) -> str:
    """The name of a law (LawInfo)."""
    return bytes(law["name"].item()).decode(errors="replace")


def params_of(spine: SpineView) -> dict[str, Any]:
    """The running law's parameters as the verb `params` tells them."""
    law = spine.running_law()
    if law is None:
        raise Refused("refused_law", "no law is running, so there are no parameters", "swap a law in first")
    live = spine.params()
    is_live = live is not None and live["law_id"] == law["law_id"]
    values = live["value"] if live is not None and is_live else law["param_value"]
    listed = [
        {
            "name": law["param_name"][i].decode(errors="replace"),
            "value": float(values[i]),
            "min": float(law["param_min"][i]),
            "max": float(law["param_max"][i]),
        }
        for i in range(int(law["param_count"]))
    ]
    return {"law": name_of(law), "law_id": int(law["law_id"]), "params": listed, "via": VIA}
