# SPDX-License-Identifier: Apache-2.0
"""The robot as the agent sees it, over a connection that may be slow and may break.

What only reads, and `activate`, is asked again after a broken connection. A swap, `reset`, `recover` and `arm` never
are: what came of them is read from the robot. One thread.
"""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from .._wire import Fault, Mode
from ..errors import LitheError, NotRunning, Refused
from ..identify import Description, Motion
from ..remote import Remote
from ..vocabulary import Tier

FIELDS = ["tick", "sample_ns", "mode", "position_rad", "velocity_rad_s", "torque_nm"]
LEAST_SHARE = 0.25  # of the window's ticks that must have been in mode active, under the law in question
PROBATION_S = 2.0  # asked for in every swap: an agent never gets along without it
LEASE_S, ALIVE_S = 120.0, 10.0  # of the lease; how often the gateway hears of an agent that waits for something else
AWAY = ("busy", "disconnected")  # refusals that may pass, as a broken connection may
LATE_S = 10.0  # after a connection broke, its last request may still reach the robot for so long
MOST_COMPILE_S = 120.0  # how long a swap that has reached the robot may take until it is committed or refused
MOST_PROBATION_S = 30.0
RUNS = ("committed", "unproven")  # while the robot rests, as where a connection broke, probation goes on
OVER = ("confirmed", "rolled_back", "not_confirmed", "refused")  # an unproven law is still on probation
BY_LAW = (Fault.position_limit, Fault.velocity_limit, Fault.law_not_finite, Fault.law_faulted)
# After these stops verbs lead back. After the others a person looks at a drive, or has stopped the robot.
MENDABLE = {each.name for each in (*BY_LAW, Fault.sample_stale, Fault.deadline_missed, Fault.brain_stale,
                                   Fault.plan_torn)}  # fmt: skip
MOST_STEPS = 10  # of one way back: a verb, or a wait until the drives are ready
BY_PERSON = ("disarmed", "held", "estop")  # events: nothing here asks for these
MOST_RECOVER_S = 60.0
ARMED_S = 0.5  # so long it must then stay active


class AnotherLaw(LitheError):
    """A law runs that this program did not put in; it stays."""


class Lost(LitheError):
    """The robot cannot be reached, may not be moved from here any more, or no verb leads back: a person's turn."""


class Stopped(LitheError):
    """The robot or a group of its joints has stopped. `by_law`: motion or law made it; `mendable`: verbs lead back."""

    def __init__(self, status: dict[str, Any]) -> None:
        self.stop: dict[str, Any] = status.get("stopped_by") or {}
        mode, fault = self.now = str(status.get("mode")), str(status.get("fault"))
        self.by_law = fault in [each.name for each in BY_LAW]
        self.mendable = mode in ("safe_stop", "active") and fault in MENDABLE
        next_step = f". Next: {self.stop['next']}" if self.stop.get("next") else ""
        super().__init__(f"the robot is in mode {mode}, fault {fault}: {self.stop.get('text', '')}{next_step}")


@dataclass(frozen=True)
class Outcome:
    """Of a swap. `verdict`: a refusal's code, or the certificate's verdict; `runs`: the new law runs now."""

    verdict: str
    runs: bool
    law_id: int = 0
    said: str = ""
    detail: dict[str, Any] = field(default_factory=dict)


def columns_of(pieces: list[dict[str, Any]], fields: list[str]) -> dict[str, npt.NDArray[np.float64]]:
    """Answers of the verb `history`, one after the other: columns of shape (n,), or (n, joints)."""
    return {name: np.concatenate([np.asarray(one[name], dtype=float) for one in pieces]) for name in fields}


def motions_of(columns: dict[str, npt.NDArray[np.float64]]) -> list[Motion]:
    """Those columns as the motion of each joint."""
    t_s = (columns["sample_ns"] - columns["sample_ns"][0]) * 1e-9
    moved = (columns["position_rad"].T, columns["velocity_rad_s"].T, columns["torque_nm"].T)
    return [Motion(t_s, *one) for one in zip(*moved, strict=True)]


class Link:
    """`within_s`: how long a broken connection is tried again. `say` is told of every request that changes anything."""

    def __init__(
        self,
        remote: Remote,
        say: Callable[..., None] = lambda kind, **what: None,
        within_s: float = 30.0,
        sleep: Callable[[float], None] = time.sleep,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._remote, self.say, self._within_s, self.sleep, self.now_s = remote, say, within_s, sleep, now_s
        self.swaps = 0  # that were sent
        self._put_in: set[int] = set()  # laws, by these swaps
        self._pending = ""  # the swap of which the law's id is not known
        self._leased = self._broke = False
        self.gone = False  # given up: nothing can be asked any more, or nothing may be
        about = self.call("describe")
        self.rate_hz = float(about["rate_hz"])
        self._of_a_person = about.get("tier") == Tier.person.name
        self.joints: list[dict[str, Any]] = about["joints"]
        self.names = [str(joint["name"]) for joint in self.joints]
        chain = about.get("chain")
        self.chain = Description(**chain) if chain else None

    def take(self) -> None:
        """The right to move the robot; after a connection broke it is taken anew. Refused: another has it."""
        self.call("lease", take=True, seconds=LEASE_S)
        self._leased = True

    def call(self, verb: str, /, **args: Any) -> Any:
        """Any verb but swap, as long as needed over a connection that breaks. Lost: for too long."""
        until_s = self.now_s() + self._within_s
        while True:
            try:
                if self._broke and self._leased:
                    self._remote.call("lease", take=True, seconds=LEASE_S)
                self._broke = False
                return self._remote.call(verb, **args)
            except Refused as refusal:
                if refusal.code not in AWAY:
                    self._check(refusal)
                    raise
                self._lost(verb, refusal)
            except NotRunning as error:
                self._lost(verb, error)
            if self.gone or self.now_s() > until_s:
                self.gone = True
                raise Lost(f"the robot cannot be reached for {self._within_s:g} s")
            self.sleep(0.5)

    def _lost(self, verb: str, error: LitheError) -> None:
        self._broke = True
        self.say("disconnected", verb=verb, message=str(error))

    def _check(self, refusal: Refused) -> None:
        """Lost when another client has taken the lease meanwhile: then nothing here may move the robot any more."""
        if refusal.code == "leased" and self._leased:
            self.gone = True
            raise Lost(f"another client moves the robot now: {refusal.message}") from None

    @contextlib.contextmanager
    def alive(self) -> Iterator[None]:
        """While this program waits for something else, the gateway hears of it: its lease and its reference go on."""
        over = threading.Event()

        def tell() -> None:
            verb, args = ("lease", {"take": True, "seconds": LEASE_S}) if self._leased else ("reference", {})
            while not over.wait(ALIVE_S):
                with contextlib.suppress(LitheError):
                    self._remote.call(verb, **args)

        threading.Thread(target=tell, name="lithe-agent-alive", daemon=True).start()
        try:
            yield
        finally:
            over.set()

    def law_id(self) -> int:
        """Of the law that runs. Stopped: none does, or not at all joints."""
        now = self.call("latest", fields=["mode", "fault", "law_id"])
        if now["mode"] != Mode.active or now["fault"] != Fault.none:
            raise Stopped(self.call("status", brief=False))
        return int(now["law_id"])

    def measure(self, seconds: float) -> tuple[dict[str, Any], list[Motion]]:
        """What the verb `measure` says of the next `seconds`, and the motion of each joint.

        LitheError: no telemetry, or in too few ticks of this time the law ran that runs at its end. Stopped: none runs.
        """
        since = int(self.call("latest", fields=["tick"])["tick"])
        until_s = self.now_s() + seconds
        pieces: list[dict[str, Any]] = []
        while (left_s := until_s - self.now_s()) > 0:
            self.sleep(min(1.0, max(left_s, 0.05)))
            piece = self.call("history", seconds=4.0, since_tick=since, fields=FIELDS)
            if piece["tick"]:
                since = int(piece["tick"][-1])
                pieces.append(piece)
        try:
            told: dict[str, Any] = self.call("measure", seconds=seconds)
        except Refused:
            self.law_id()  # Stopped says it better
            raise
        if not pieces:
            raise LitheError(f"no telemetry came in {seconds:g} s")
        if told["ticks"] < LEAST_SHARE * seconds * self.rate_hz:
            raise LitheError(f"only {told['ticks']} ticks were under the law in question")
        columns = columns_of(pieces, FIELDS)
        return told, motions_of({name: values[columns["mode"] == Mode.active] for name, values in columns.items()})

    def swap(self, source: str, name: str, known: bool = False) -> Outcome:
        """The law through the whole swap, always with probation. Never raises Refused: that is an outcome.

        `known`: it ran before, so its error is known and not judged again, where the gateway's tier permits that.
        After a stop there is no time before the swap to compare it with.
        """
        before, earlier = self.law_id(), self._last_swap().get("request_id")
        return self._swapped(source, name, before, earlier, known)

    def _swapped(self, source: str, name: str, before: int, earlier: Any, known: bool) -> Outcome:
        terms = {"probation_s": PROBATION_S} | ({"error_ratio": 0} if known and self._of_a_person else {})
        self.say("swap", name=name, **terms)
        self.swaps, self._pending = self.swaps + 1, name
        try:
            with self.alive():
                answer = self._remote.call("swap", source=source, name=name, brief=False, **terms)
        except Refused as refusal:
            self._pending = ""
            self._check(refusal)
            self.say("refused", name=name, code=refusal.code, message=refusal.message, detail=refusal.detail)
            said = f"{refusal.message} Next: {refusal.next}" if refusal.next else refusal.message
            return Outcome(refusal.code, False, before, said, dict(refusal.detail))
        except NotRunning as error:
            self._lost("swap", error)
            done = self.outcome(name, before, earlier, OVER + RUNS)
        else:
            self.say("committed", name=name, certificate=answer)
            done = Outcome(str(answer.get("verdict")), True, int(answer.get("law_id", 0)), detail=answer)
        if done.runs:
            self._put_in.add(done.law_id)
            self._pending = ""
        return done

    def put_in(self, law_id: int) -> bool:
        """Whether a swap of this program put that law, which runs now, in."""
        return law_id in self._put_in or bool(self._pending and self._last_swap().get("source") == self._pending)

    def _last_swap(self) -> dict[str, Any]:
        return self.call("status", brief=False).get("last_swap") or {}

    def outcome(self, name: str, before: int, earlier: Any = None, over: tuple[str, ...] = OVER) -> Outcome:
        """What came of the swap of that name: waits for one of these verdicts, for a bounded time.

        earlier: the `request_id` of the swap before it, which may have had the same name.
        """
        since_s = self.now_s()
        while True:
            last = self._last_swap()
            ours = last.get("source") == name and (earlier is None or last.get("request_id") != earlier)
            verdict = str(last.get("verdict", "")) if ours else "unknown"
            now = self.law_id()
            most_s = (MOST_COMPILE_S if verdict == "submitted" else MOST_PROBATION_S) if ours else LATE_S
            if verdict in over or self.now_s() > since_s + most_s:
                said = str(last.get("reason", "")) if ours else "the swap did not reach the robot"
                runs = now != before and ours and verdict not in ("rolled_back", "refused")
                self.say("verdict", name=name, verdict=verdict, reason=said, law_id=now)
                return Outcome(verdict, runs, now, said, dict(last) if ours else {})
            self.sleep(0.2)

    def source_of(self, law_id: int) -> str:
        """The text of a law that was swapped in, from the gateway's documents; "": none of them has it."""
        try:
            swaps = json.loads(self.call("document", name="swaps")["text"])
            certificate = next(one["certificate"] for one in reversed(swaps) if one.get("law_id") == law_id)
            return str(self.call("document", name=f"{certificate}.cpp")["text"])
        except (Refused, StopIteration, KeyError, ValueError):
            return ""

    def taken_back(self) -> str:
        """Why the Spine took a law back last, and what to change: its own words."""
        told = self.call("events", limit=100)["events"]
        kinds = ("law_faulted", "law_rolled_back")
        last: dict[str, Any] = next((one for one in reversed(told) if one.get("kind") in kinds), {})
        return f"{last.get('text', '')}" + (f". Next: {last['next']}" if last.get("next") else "")

    def _once(self, verb: str) -> Refused | None:
        """Why a verb of the way back was refused. None: it was done, or the connection broke; the status says which."""
        self.say("way_back", verb=verb)
        try:
            self._remote.call(verb)
        except NotRunning as error:
            self._lost(verb, error)
        except Refused as refusal:
            self._check(refusal)
            self.say("refused", name=verb, code=refusal.code, message=refusal.message)
            return refusal if refusal.code != "disconnected" else None
        return None

    def _activated(self, law_id: int) -> bool:
        """Whether `activate` was not refused; then waits until that law runs, or would once armed."""
        self.say("way_back", verb="activate", law=law_id)
        try:
            self.call("activate", law=law_id)
        except Refused as refusal:
            self.say("refused", name="activate", code=refusal.code, message=refusal.message)
            return False
        until_s = self.now_s() + 2.0
        while self.call("latest", fields=["law_id"])["law_id"] != law_id and self.now_s() < until_s:
            self.sleep(0.05)
        return True

    def go_back_to(self, law_id: int, source: str, name: str) -> int:
        """That law runs again, by `activate`; where it is no longer loaded, by a swap of its source. Its id now.

        LitheError: it does not run.
        """
        if self.law_id() == law_id:
            return law_id
        if not self._activated(law_id) and source and (done := self.swap(source, name, known=True)).runs:
            return done.law_id
        if self.law_id() != law_id:
            raise LitheError(f"the best law does not run: law {self.law_id()} does, and no verb leads to law {law_id}")
        return law_id

    def come_back(self, law_id: int, source: str, name: str) -> int:
        """After a stop: that law runs again, armed once. Its id now.

        Before each verb the status is judged anew. Lost: no verb leads there, or a person stopped the robot. Stopped:
        it did not stay active. AnotherLaw: another client put one in.
        """
        left_in, verb, there = "", "arm", False  # left_in: the mode in which the last verb here leaves the robot
        refusal: Refused | None = None
        for _ in range(MOST_STEPS):
            status = self.call("status", brief=False)
            stop = Stopped(status)
            self._nobody_else(stop)
            if stop.mendable:
                self._once("reset")
                left_in, verb = "disarmed", "arm"
            elif stop.now != (left_in, "none"):
                raise Lost(f"{stop}; this is for a person to look at")
            elif not there:
                law_id, there = self._put_back(law_id, source, name), True
            elif status["law_id"] != law_id:
                raise AnotherLaw(f"law {status['law_id']} is there in place of law {law_id}: another client put it in")
            elif status.get("recovering"):
                self._brought_inside()
            elif (refusal := self._once(verb)) is not None:
                if refusal.code == "refused_fault":  # the law stopped it in the first tick
                    raise Stopped(self.call("status", brief=False))
                verb = "recover" if refusal.code == "refused_outside" else verb
                self.sleep(1.0)
            elif verb == "recover":
                left_in, verb = "recover", "arm"
            else:
                self.sleep(ARMED_S)
                self.law_id()
                return law_id
        raise Lost(f"no verb led back: {refusal or stop}")

    def _nobody_else(self, stop: Stopped) -> None:
        """Lost: since the last stop a person disarmed or stopped the robot, or had it hold."""
        kinds = [str(each.get("kind")) for each in self.call("events", limit=100)["events"]]
        stops = [at for at, kind in enumerate(kinds) if kind in ("safe_stop", "group_stopped")]
        if found := [kind for kind in kinds[stops[-1] if stops else 0 :] if kind in BY_PERSON]:
            raise Lost(f"{stop}; {found[-1]} by another client meanwhile: this is for a person to look at")

    def _put_back(self, law_id: int, source: str, name: str) -> int:
        """Of a robot at rest: that law is there for `arm`. Its id now. Lost: it is not, so that nobody arms another."""
        if self._activated(law_id):
            return law_id
        earlier = self._last_swap().get("request_id")
        done = self._swapped(source, name, 0, earlier, known=True) if source else Outcome("", False)
        if not done.law_id:
            raise Lost(f"no verb leads back to law {law_id}: {done.said}")
        return done.law_id

    def _brought_inside(self) -> None:
        """Waits for the end of `recover`. Lost: it does not end."""
        until_s = self.now_s() + MOST_RECOVER_S
        while self.call("status", brief=False).get("recovering"):
            if self.now_s() > until_s:
                raise Lost(f"recover takes longer than {MOST_RECOVER_S:g} s")
            self.sleep(0.2)
