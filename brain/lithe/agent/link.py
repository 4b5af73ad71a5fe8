# SPDX-License-Identifier: Apache-2.0
"""The robot as the agent sees it, over a connection that may be slow and may break.

What only reads, and what goes back, is asked again after a broken connection; a swap never is: what came of it is read
from the robot, and so is what came of a rollback. One thread.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from .._wire import Mode
from ..errors import LitheError, NotRunning, Refused
from ..identify import Arm, Motion, identify_joint

Vector = npt.NDArray[np.float64]
FIELDS = [
    "tick", "sample_ns", "mode", "law_id", "position_rad", "velocity_rad_s", "torque_nm", "setpoint_position_rad",
]  # fmt: skip
LEAST_SHARE = 0.25  # of the window's ticks that must have been in mode active, under the law in question
PROBATION_S = 2.0  # asked for in every swap: an agent never gets along without it
LEASE_S, ALIVE_S = 120.0, 10.0  # of the lease; how often the gateway hears of an agent that waits for something else
AWAY = ("busy", "disconnected")  # refusals that may pass, as a broken connection may
LATE_S = 10.0  # after a connection broke, its last request may still reach the robot for so long
MOST_COMPILE_S = 120.0  # how long a swap that has reached the robot may take until it is committed or refused
MOST_PROBATION_S = 30.0
RUNS = ("committed", "unproven")  # while the robot rests, as where a connection broke, probation goes on
OVER = ("confirmed", "rolled_back", "not_confirmed", "refused")  # an unproven law is still on probation


class Stopped(LitheError):
    """The robot has left the mode `active`, or cannot be reached any more: a person's turn."""


class Caller(Protocol):
    """lithe.Remote, or a fake in tests."""

    def call(self, verb: str, /, **args: Any) -> Any: ...


@dataclass(frozen=True)
class Outcome:
    """Of a swap. `verdict`: a refusal's code, or the certificate's verdict; `runs`: the new law runs now."""

    verdict: str
    runs: bool
    law_id: int = 0
    said: str = ""
    detail: dict[str, Any] = field(default_factory=dict)


class Link:
    """`within_s`: how long a broken connection is tried again. `say` is told of every request that changes anything."""

    def __init__(
        self,
        remote: Caller,
        say: Callable[..., None] = lambda kind, **what: None,
        within_s: float = 30.0,
        sleep: Callable[[float], None] = time.sleep,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._remote, self._say, self._within_s, self.sleep, self.now_s = remote, say, within_s, sleep, now_s
        self._leased = self._broke = False
        self.gone = False  # given up: nothing can be asked any more, or nothing may be
        about = self.call("describe")
        self.rate_hz = float(about["rate_hz"])
        self.joints: list[dict[str, Any]] = about["joints"]
        self.names = [str(joint["name"]) for joint in self.joints]

    def take(self) -> None:
        """The right to move the robot; after a connection broke it is taken anew. Refused: another has it."""
        self.call("lease", take=True, seconds=LEASE_S)
        self._leased = True

    def call(self, verb: str, /, **args: Any) -> Any:
        """Any verb but swap and rollback, as long as needed over a connection that breaks. Stopped: for too long."""
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
                raise Stopped(f"the robot cannot be reached for {self._within_s:g} s")
            self.sleep(0.5)

    def _lost(self, verb: str, error: LitheError) -> None:
        self._broke = True
        self._say("disconnected", verb=verb, message=str(error))

    def _check(self, refusal: Refused) -> None:
        """Stopped when another client has taken the lease meanwhile: then nothing here may move the robot any more."""
        if refusal.code == "leased" and self._leased:
            self.gone = True
            raise Stopped(f"another client moves the robot now: {refusal.message}") from None

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
        """Of the law that runs. Stopped: none does."""
        now = self.call("latest", fields=["mode", "law_id"])
        if now["mode"] != Mode.active:
            status = self.call("status")
            raise Stopped(
                f"the robot is in mode {status.get('mode')} (fault: {status.get('fault')}), so no law runs\n"
                "  next: `lithe status` says why; `lithe reset` and `lithe arm` when a person has seen it"
            )
        return int(now["law_id"])

    def measure(self, seconds: float) -> tuple[Vector, list[Motion], int]:
        """RMSE of each joint [rad] over the next `seconds`, its motion, and the law that ran all the while.

        Only ticks in mode active under that law count. LitheError: there were too few of them.
        """
        law_id = self.law_id()
        since = int(self.call("latest", fields=["tick"])["tick"])
        until_s = self.now_s() + seconds
        pieces: list[dict[str, Any]] = []
        while (left_s := until_s - self.now_s()) > 0 or not pieces:
            self.sleep(min(1.0, max(left_s, 0.05)))
            piece = self.call("history", seconds=4.0, since_tick=since, fields=FIELDS)
            if piece["tick"]:
                since = int(piece["tick"][-1])
                pieces.append(piece)
        columns = {name: np.concatenate([np.asarray(one[name], dtype=float) for one in pieces]) for name in FIELDS}
        good = (columns["mode"] == Mode.active) & (columns["law_id"] == law_id)
        if np.count_nonzero(good) < LEAST_SHARE * seconds * self.rate_hz:
            self.law_id()  # Stopped says it better
            raise LitheError(f"only {np.count_nonzero(good)} of {len(good)} ticks were under the law in question")
        kept = {name: values[good] for name, values in columns.items()}
        error_rad = kept["setpoint_position_rad"] - kept["position_rad"]
        t_s = (kept["sample_ns"] - kept["sample_ns"][0]) * 1e-9
        moved = (kept["position_rad"].T, kept["velocity_rad_s"].T, kept["torque_nm"].T)
        motions = [Motion(t_s, *one) for one in zip(*moved, strict=True)]
        rmse: Vector = np.sqrt(np.mean(error_rad**2, axis=0))
        return rmse, motions, law_id

    def swap(self, source: str, name: str) -> Outcome:
        """The law through the whole transaction, always with probation. Never raises Refused: that is an outcome."""
        before, earlier = self.law_id(), self._last_swap().get("request_id")
        self._say("swap", name=name, probation_s=PROBATION_S)
        try:
            with self.alive():
                answer = self._remote.call("swap", source=source, name=name, probation_s=PROBATION_S)
        except Refused as refusal:
            self._check(refusal)
            self._say("refused", name=name, code=refusal.code, message=refusal.message, detail=refusal.detail)
            said = f"{refusal.message} Next: {refusal.next}" if refusal.next else refusal.message
            return Outcome(refusal.code, False, before, said, dict(refusal.detail))
        except NotRunning as error:
            self._lost("swap", error)
            return self.outcome(name, before, earlier, OVER + RUNS)
        self._say("committed", name=name, certificate=answer)
        return Outcome(str(answer.get("verdict")), True, int(answer.get("law_id", 0)), detail=answer)

    def _last_swap(self) -> dict[str, Any]:
        return self.call("status").get("last_swap") or {}

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
                self._say("verdict", name=name, verdict=verdict, reason=said, law_id=now)
                return Outcome(verdict, runs, now, said, dict(last) if ours else {})
            self.sleep(0.2)

    def _roll_back(self) -> bool:
        """One step, asked for once. False: whether it was done is not known."""
        try:
            self._remote.call("rollback", steps=1)
        except Refused as refusal:
            self._say("refused", name="rollback", code=refusal.code, message=refusal.message)
        except NotRunning as error:
            self._lost("rollback", error)
            return False
        return True

    def go_back_to(self, law_id: int, source: str, name: str) -> int:
        """That law runs again, by a rollback; where that leads elsewhere, by a swap of its source. Its id now.

        A rollback whose answer is lost is asked for again only when the law has not changed for LATE_S: a second step
        would lead too far back. LitheError: it does not run.
        """
        first = now = self.law_id()
        known = False
        while now == first != law_id and not known:
            self._say("rollback", to=law_id)
            known = self._roll_back()
            until_s = self.now_s() + (2.0 if known else LATE_S)
            while (now := self.law_id()) == first and self.now_s() < until_s:
                self.sleep(0.05)
        if now == law_id:
            return now
        if source:
            done = self.swap(source, name)
            if done.runs:
                return done.law_id
        raise LitheError(f"the best law does not run: law {self.law_id()} does, and no rollback leads to law {law_id}")


def identified(names: list[str], motions: list[list[Motion]]) -> list[dict[str, Any]]:
    """What `lithe.identify` finds of each joint in all its motions; where they do not tell, why."""
    found: list[dict[str, Any]] = []
    for name, those in zip(names, motions, strict=True):
        try:
            arm: Arm = identify_joint(those)
        except (ValueError, np.linalg.LinAlgError) as error:
            found.append({"joint": name, "unknown": str(error)})
            continue
        found.append({
            "joint": name,
            "gravity_nm": round(arm.mgl_nm, 5), "gravity_se_nm": round(arm.mgl_se_nm, 5),
            "gravity_zero_rad": round(arm.zero_rad, 4),
            "inertia_kg_m2": float(f"{arm.inertia_kg_m2:.4g}"), "coulomb_nm": round(max(arm.coulomb_nm, 0.0), 5),
            "viscous_nm_s_rad": round(arm.viscous_nm_s_rad, 5),
        })  # fmt: skip
    return found
