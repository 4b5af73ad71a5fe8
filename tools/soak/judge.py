# SPDX-License-Identifier: Apache-2.0
"""What must hold all the time. Each check counts what it has looked at, keeps the worst value and raises Broken."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from lithe._wire import Fault, JointStatus, Mode, Rung
from lithe.programs import ROOT

INVARIANTS = {
    "inside": "no joint that a law moves is beyond its limit and the overrun at which the guard must stop it",
    "torque": "every command is finite and within the joint's torque",
    "ticking": "the Spine lives, ticks, and is the same process unless it was killed on purpose",
    "answers": "every verb is answered, with a code of docs/reference/verbs.md",
    "certificates": "the chain holds, and each answer to a swap is what its certificate says",
    "refused_law": "no law that was refused is in force, and no law that must be refused is accepted",
    "way_back": "after each action verbs alone lead back to `active`",
    "processes": "killed helpers are replaced, and a new supervisor adopts the Spine as it is",
    "growth": "no process, no shared memory and no folder of certificates grows with time",
}
BAD = JointStatus.fault | JointStatus.lost | JointStatus.garbled | JointStatus.conflict | JointStatus.not_homed
IN_A_ROW = 3  # samples beyond: the guard sees one, and its stop shows in the next tick
STILL_S = 30.0  # a Spine that has not ticked for so long does not tick; a busy machine may stop it for seconds
COMMITTED = frozenset({"committed", "unproven", "confirmed", "rolled_back"})
REFUSED_AT = {
    "compile": ["compile_failed"],
    "admission": ["admission_failed"],
    "trial": ["trial_failed", "dry_run_failed"],
}
UNKNOWN = frozenset({"timeout", "robot_fault", "stopping"})  # after these answers the law may still be committed


class Broken(Exception):
    """An invariant does not hold."""

    def __init__(self, invariant: str, why: str) -> None:
        super().__init__(f"{invariant}: {why}")
        self.invariant, self.why = invariant, why


def codes_of_the_page() -> frozenset[str]:
    """Every code of a refusal that docs/reference/verbs.md has, and the faults (`recover` answers with one)."""
    page = (ROOT / "docs/reference/verbs.md").read_text(encoding="utf-8").partition("## Codes of a refusal")[2]
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    return frozenset(re.findall(r"`(\w+)`", " ".join(rows))) | {fault.name for fault in Fault}


@dataclass(frozen=True)
class Joints:
    """Limits of the robot's joints, in their order."""

    low_rad: npt.NDArray[np.float64]
    high_rad: npt.NDArray[np.float64]
    torque_nm: npt.NDArray[np.float64]
    overrun_rad: float

    @staticmethod
    def of(info: npt.NDArray[Any], overrun_rad: float) -> Joints:
        """From the Spine's RobotInfo."""
        rows = [np.array(info[name][: int(info["joint_count"])]) for name in LIMITS]
        return Joints(rows[0], rows[1], rows[2], overrun_rad)


LIMITS = ("position_min_rad", "position_max_rad", "torque_max_nm")


class Judge:
    """Checks evidence as it comes. Threads: one at a time."""

    def __init__(self, codes: frozenset[str]) -> None:
        self.codes = codes
        self.checked: Counter[str] = Counter()
        self.worst: dict[str, float] = {}
        self.stops: Counter[str] = Counter()  # how often which fault was latched
        self._tick: tuple[int, int, float] | None = None  # pid, tick, when it was new
        self._fault = 0
        self._last: tuple[int, npt.NDArray[np.bool_]] | None = None  # tick and rows at the end of the read before

    def _note(self, invariant: str, count: int = 1, **worst: float) -> None:
        self.checked[invariant] += count
        for name, value in worst.items():
            self.worst[name] = max(self.worst.get(name, value), value)

    def records(self, records: npt.NDArray[Any], joints: Joints, blind: bool) -> None:
        """Telemetry in order. `blind`: a fault is injected into the bus, so positions need not be true."""
        if len(records) == 0:
            return
        count = len(joints.low_rad)
        faults = np.concatenate([[self._fault], records["fault"]])
        for each in faults[1:][(np.diff(faults.astype(np.int64)) != 0) & (faults[1:] != 0)]:
            self.stops[Fault(int(each)).name] += 1
        self._fault = int(faults[-1])
        share = np.abs(records["command_torque_nm"][:, :count]) / joints.torque_nm
        if not np.isfinite(share).all() or share.max() > 1 + 1e-9:
            at = int(np.argmax(~np.isfinite(share).all(axis=1) | (share.max(axis=1) > 1 + 1e-9)))
            raise Broken("torque", f"tick {records['tick'][at]}: {share[at].tolist()} of the joints' torque")
        self._note("torque", len(records), torque_share=float(share.max()))
        if blind:
            self._last = None
            return
        status = records["joint_status"][:, :count]
        moved = (np.isin(records["mode"], (Mode.active, Mode.hold)))[:, None]
        moved = moved & (records["joint_rung"][:, :count] == Rung.law)
        moved = moved & ((status & JointStatus.fresh) != 0) & ((status & BAD) == 0)
        position = records["position_rad"][:, :count]
        outside = np.where(moved, np.maximum(joints.low_rad - position, position - joints.high_rad), -np.inf)
        self._note("inside", int(moved.any(axis=1).sum()))
        if moved.any():
            self._note("inside", 0, outside_rad=float(outside.max()))
        beyond = outside > joints.overrun_rad
        ticks = records["tick"]
        if self._last is not None and self._last[0] + 1 == int(ticks[0]):
            beyond = np.concatenate([self._last[1], beyond])
        before = len(beyond) - len(records)  # rows of the read before
        self._last = (int(ticks[-1]), beyond[1 - IN_A_ROW :])
        in_a_row = np.ones((max(len(beyond) - IN_A_ROW + 1, 0), count), bool)
        for i in range(IN_A_ROW):
            in_a_row &= beyond[i : i + len(in_a_row)]
        if in_a_row.any():
            at, joint = (int(each) for each in np.argwhere(in_a_row)[0])
            at = max(at - before, 0)
            why = f"tick {ticks[at]}: joint {joint} at {position[at, joint]:.4f} rad, and a law moves it"
            raise Broken("inside", why)

    def alive(self, pid: int, expected: int, tick: int, now_s: float, is_alive: bool = True) -> None:
        """One look at the Spine. `expected`: the process that must tick; 0 while it is killed on purpose."""
        if not expected:
            self._tick = None
            return
        if pid != expected or not is_alive:
            raise Broken("ticking", f"Spine {expected} is gone, and nobody killed it (now: {pid})")
        if self._tick is not None and self._tick[0] == pid:
            still_s = now_s - self._tick[2]
            if tick < self._tick[1]:
                raise Broken("ticking", f"tick {tick} after tick {self._tick[1]} of the same process")
            if tick == self._tick[1]:
                if still_s > STILL_S:
                    raise Broken("ticking", f"Spine {pid} stands at tick {tick} for {still_s:.0f} s")
                return
            self._note("ticking", 1, still_s=still_s)
        self._tick = (pid, tick, now_s)

    def answer(self, verb: str, code: str) -> None:
        """The code of an answer: "ok", or that of a refusal."""
        if code != "ok" and code not in self.codes:
            raise Broken("answers", f"'{verb}' was refused with the unknown code '{code}'")
        self._note("answers")

    def verdict(self, code: str, answer: dict[str, Any], certificate: dict[str, Any]) -> None:
        """The answer to a swap (its certificate then, or the detail of its refusal) beside its certificate now."""
        verdict, number = certificate.get("verdict"), certificate.get("request_id")
        allowed = COMMITTED if code == "ok" else {"refused"}
        if code in UNKNOWN:
            allowed = COMMITTED | {"refused", "not_confirmed"}
        if verdict not in allowed:
            raise Broken("certificates", f"swap {number} was answered '{code}', its certificate says '{verdict}'")
        for name in ("law_id", "commit_tick", "source_sha256"):
            if code == "ok" and answer.get(name) != certificate.get(name):
                told = f"{name} {answer.get(name)}, its certificate {certificate.get(name)}"
                raise Broken("certificates", f"swap {number} was answered with {told}")
        self._note("certificates")

    def in_force(self, law_id: int, certificate: dict[str, Any] | None, excused: bool) -> None:
        """A law that ran. `excused`: a supervisor was killed during a swap, and could not write its end."""
        if certificate is None and not excused:
            raise Broken("refused_law", f"law {law_id} ran, and no certificate says that it was committed")
        if certificate is not None and certificate.get("verdict") == "refused":
            raise Broken("refused_law", f"law {law_id} ran, and its certificate says 'refused'")
        self._note("refused_law")

    def must_be_refused(self, law: str, stage: str, code: str) -> None:
        """The answer to a hostile law that an earlier stage than the tick must stop. Other codes say nothing of it."""
        if code == "ok" or any(code in codes for other, codes in REFUSED_AT.items() if other != stage):
            what = "accepted" if code == "ok" else f"refused as {code}"
            raise Broken("refused_law", f"{law} was {what}; {stage} must refuse it")
        if code in REFUSED_AT[stage]:
            self._note("refused_law")

    def holds(self, invariant: str, what: bool, why: Callable[[], str] | str, **worst: float) -> None:
        """Any other check."""
        if not what:
            raise Broken(invariant, why if isinstance(why, str) else why())
        self._note(invariant, 1, **worst)


def corpus_stage(law: Path) -> str:
    """At which stage a law of tests/laws_hostile must be stopped, as its first lines say."""
    found = re.search(r"^// stopped-by: (\S+)$", law.read_text(encoding="utf-8"), re.M)
    return found[1] if found else ""
