# SPDX-License-Identifier: Apache-2.0
"""Whether the law or its parameters have changed since a client's last call, why, and how to come back.

A law leaves without the client's doing: it fails in the tick, its probation takes it back, another client replaces it,
or the robot is started again. The next answer of a verb in TELL then has `law_changed`.
Threads: all methods may be called from any thread.
"""

from __future__ import annotations

import contextlib
import json
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any

from .._wire import TelemetryFlags
from ..errors import LitheError, Refused
from ..mailbox import params_of
from ..robot import Robot
from .peer import Peer

Json = dict[str, Any]
OWN = frozenset({"swap", "set_params", "activate", "rollback", "revert_params"})  # their answers say what runs
TELL = OWN | {
    "measure", "status", "params", "law_list", "reference", "set_reference", "stop_reference", "arm", "reset",
    "recover", "hold",
}  # fmt: skip
CAUSES = {
    "law_committed", "law_rolled_back", "params_applied", "params_reverted", "params_went_back", "safe_stop",
    "group_stopped",
}  # fmt: skip
MOST_CAUSES = 5
MOST_CLIENTS = 64  # remembered, also after their last connection broke
SETTLE_S = 0.005  # the Spine publishes a law and its parameters one after the other


@dataclass(frozen=True)
class Seen:
    """What ran at a time. `values`: None where they are not known; `source`: the document with its text, or ""."""

    run: object
    law: str
    law_id: int
    values: dict[str, float] | None
    source: str
    at_ns: int

    def told(self) -> Json:
        return {"law": self.law or None, "law_id": self.law_id, "params": self.values}


class LawWatch:
    """Remembers for each client which law and parameters it last knew to be in force."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._lock = threading.Lock()
        self._seen: dict[object, Seen] = {}

    def change(self, client: Peer | None) -> tuple[Json | None, Seen | None]:
        """What changed since this client was last told (None: nothing), and what runs now, for knows()."""
        if client is None or not self._robot.attached:
            return None, None
        with self._lock:
            old = self._seen.get(client.key)
        now = self._now(old)
        if old is None or _same(old, now):
            return None, now
        time.sleep(SETTLE_S)
        now = self._now(old)
        return (None if _same(old, now) else self._changed(old, now)), now

    def knows(self, client: Peer | None, now: Seen | None) -> None:
        """The client was told that."""
        if client is None or now is None:
            return
        with self._lock:
            self._seen.pop(client.key, None)
            self._seen[client.key] = now
            while len(self._seen) > MOST_CLIENTS:
                self._seen.pop(next(iter(self._seen)))

    def did(self, client: Peer | None, answer: Json, asked_ns: int) -> None:
        """After a verb of OWN: the client knows what its answer says; a law that has left since then is news to it."""
        if client is None or not self._robot.attached:
            return
        with self._lock:
            old = self._seen.get(client.key)
        now, law_id = self._now(old), answer.get("law_id")
        if law_id and law_id != now.law_id and answer.get("verdict") != "rolled_back":
            number = str(answer.get("certificate", "")).removeprefix("swaps/").removesuffix(".json")
            source = f"swaps/{number}.cpp" if number else ""
            now = replace(
                now, law=str(answer.get("law")), law_id=int(law_id), values=None, source=source, at_ns=asked_ns
            )
        self.knows(client, now)

    def _now(self, old: Seen | None) -> Seen:
        """Asks the supervisor for the law's text only when it is another law."""
        at_ns, run = time.monotonic_ns(), self._robot.spine
        try:
            told = params_of(run)
        except Refused:  # no law runs
            return Seen(run, "", 0, {}, "", at_ns)
        law_id = int(told["law_id"])
        known = old is not None and (old.run, old.law_id) == (run, law_id)
        source = old.source if old is not None and known else next(
            (str(each.get("source") or "") for each in self._loaded() if each["law_id"] == law_id), "")  # fmt: skip
        values = {each["name"]: each["value"] for each in told["params"]}
        return Seen(run, str(told["law"]), law_id, values, source, at_ns)

    def _loaded(self) -> list[Json]:
        with contextlib.suppress(LitheError):  # no supervisor
            loaded: list[Json] = self._robot.call("law_list")["resident"]
            return loaded
        return []

    def _changed(self, old: Seen, now: Seen) -> Json:
        told: Json = {"was": old.told(), "now": now.told(), "because": [], "next": self._way_back(old, now)}
        if old.run is not now.run:
            told["because"] = [{"kind": "started_again", "text": "the robot was started again, with its first law"}]
            return told
        with contextlib.suppress(LitheError):
            events = [each for each in self._robot.call("events")["events"]
                      if each["kind"] in CAUSES and each["t_ns"] > old.at_ns]  # fmt: skip
            kept = ("kind", "tick", "text", "next")
            told["because"] = [{key: each[key] for key in kept if each.get(key)} for each in events[-MOST_CAUSES:]]
            ticks = {each["tick"] for each in events if each.get("tick")}
            found = [each for each in self._robot.call("incidents")["incidents"] if each.get("tick") in ticks]
            if found:
                told["incident"] = found[-1]["id"]
        return told

    def _way_back(self, old: Seen, now: Seen) -> str:
        params = f", with params {old.values}" if old.values else ""
        if old.run is now.run and old.law_id == now.law_id:
            return f"set_params with values {old.values} brings them back" if old.values else "params has them now"
        same_run = old.run is now.run
        if same_run and old.law_id < now.law_id and any(each["law_id"] == old.law_id for each in self._loaded()):
            return f"activate {old.law_id} leads back to '{old.law}'"
        text = f"swap in the text of the document {old.source}" if old.source else f"swap in the text of '{old.law}'"
        return f"'{old.law}' is no longer loaded: mend the cause that `because` names, then {text}{params}"


def _same(old: Seen, now: Seen) -> bool:
    values = old.values is None or old.values == now.values
    return old.run is now.run and old.law_id == now.law_id and values


def unproven(robot: Robot) -> Json:
    """For the answer of set_reference: what this motion may take back. {}: nothing is on probation."""
    record = robot.spine.latest()
    flags = 0 if record is None else int(record["flags"])
    if not flags & TelemetryFlags.on_probation:
        return {}
    still = "unproven" if flags & TelemetryFlags.unproven else "on probation"
    with contextlib.suppress(LitheError):
        law = params_of(robot.spine)
        if not flags & TelemetryFlags.params_on_probation:
            words = f"law '{law['law']}' is {still}: this motion proves it, or the law before it runs again"
            return {"warning": f"{words}; the next answer would have law_changed"}
        pending = _pending(robot, int(law["law_id"]))
        named = ", ".join(f"{name} = {value:g} (else again {before:g})" for name, (value, before) in pending.items())
        words = f"parameters are {still}: {named or 'the last change'}: this motion proves them, or they go back"
        back = {name: before for name, (_, before) in pending.items()}
        return {"warning": f"{words}; the next answer would have law_changed", "unproven_params_else": back}
    return {}


def _pending(robot: Robot, law_id: int) -> dict[str, tuple[float, float]]:
    """Parameters without a verdict: name -> value now, value before the first of these changes."""
    source = next((each.get("source") for each in robot.call("law_list")["resident"] if each["law_id"] == law_id), None)
    status = robot.call("status")
    made = [status["last_params"] or {}]
    with contextlib.suppress(OSError, ValueError):
        path = Path(status["records"]) / PurePath(str(source)).with_suffix(".json").name
        made = json.loads(path.read_text(encoding="utf-8")).get("param_changes") or made
    pending: dict[str, tuple[float, float]] = {}
    for each in made:
        if each.get("verdict") in ("taken", "unproven"):
            for name, value in each["values"].items():
                pending[name] = (value, pending.get(name, (0.0, each["before"][name]))[1])
    return pending
