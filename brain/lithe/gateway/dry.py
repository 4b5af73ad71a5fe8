# SPDX-License-Identifier: Apache-2.0
"""`dry_run`: what a verb would do now, or why it would be refused. Nothing changes.

A law or parameters pass every gate and the trial of the supervisor; the modes are compared with the newest record.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .._wire import Fault, Mode
from ..decisions import refused_in
from ..errors import Refused
from ..robot import Robot
from ..vocabulary import BY_NAME, Tier, tier_of
from .brief import brief_detail
from .references import References

Json = dict[str, Any]
OFF = "moving joints are braked to rest, then the drives are off"
# Verb -> modes in which it has an effect, and which.
MODES: dict[str, tuple[tuple[Mode, ...], str]] = {
    "arm": ((Mode.disarmed, Mode.hold, Mode.active, Mode.recover), "torque on: the law runs from the next tick"),
    "hold": ((Mode.active, Mode.hold), "the setpoint slows down and rests; the law runs on"),
    "disarm": (tuple(mode for mode in Mode if mode is not Mode.estop), OFF),
    "recover": (
        (Mode.disarmed, Mode.safe_stop, Mode.recover),
        "joints outside their limits are brought inside, slowly and without a law",
    ),
    "sim_reset": ((Mode.disarmed,), "the simulated joints go back to their start positions"),
    "reset": (tuple(Mode), f"the fault is cleared; {OFF}"),
    "shutdown": (tuple(Mode), f"{OFF}; then robot and supervisor end"),
    "stop_reference": (tuple(Mode), "the reference comes to rest within 0.5 s"),
}

SHADOW_S = 2.0


def compared(args: Json) -> Json:
    """The arguments of `swap` that do what `shadow` does."""
    return {"shadow_s": SHADOW_S, **args, "promote": False}


def told(robot: Robot, references: References, verb: str, args: Json, tier: Tier) -> Json:
    """Of a client whose token has `tier`: `would` or `refused`."""
    record = robot.telemetry.latest()
    mode, fault = (
        (Mode.disarmed, Fault.none) if record is None else (Mode(int(record["mode"])), Fault(int(record["fault"])))
    )
    answer: Json = {"dry_run": True, "verb": verb, "mode": mode.name}
    if (needed := tier_of(BY_NAME[verb], args)) > tier:
        answer["needs_tier"] = needed.name
    try:
        return answer | _would(robot, references, verb, args, mode, fault, tier)
    except Refused as refusal:
        told = {"code": refusal.code, "message": refusal.message, "next": refusal.next}
        return answer | {"refused": told | ({"detail": brief_detail(refusal.detail)} if refusal.detail else {})}


def _would(robot: Robot, references: References, verb: str, args: Json, mode: Mode, fault: Fault, tier: Tier) -> Json:
    if verb in ("swap", "shadow"):
        return _swap(robot, args, mode, tier)
    if verb == "set_params":
        tried = robot.call("set_params", **{k: v for k, v in args.items() if k != "wait"}, dry_run=True)
        kept = {key: tried[key] for key in ("trial_ms", "warnings") if key in tried}
        return {"would": "the values passed the trial, and would be in force from one tick on", **kept}
    if verb == "set_reference":
        ramp = references.set(args, dry_run=True)
        _check_follows(mode)
        return {"would": "it starts, faded in from where the joints are", **ramp}
    if verb == "publish":
        _check_plan(references, args)
        _check_follows(mode)
        return {"would": "the Spine gets the plan; it checks times and speeds between its waypoints itself"}
    if verb == "set_inputs":
        robot.inputs.check(**args["values"])
        return {"would": "the law has them from the next tick on"}
    if verb in ("rollback", "activate"):
        return _goes_back(robot.call("law_list")["resident"], verb, args, mode)
    if verb == "revert_params":
        last = robot.call("status")["last_params"] or {}
        if not last.get("before"):
            raise Refused("refused_law", "no parameter was changed under this law", "set_params changes them")
        return {"would": f"these values again: {last['before']}"}
    modes, would = MODES[verb]
    latched = fault is not Fault.none
    if mode not in modes or (verb == "arm" and latched and mode is Mode.disarmed) or (verb == "reset" and not latched):
        words = f"cannot {verb} in mode {mode.name} with fault {fault.name}"
        raise Refused("refused_mode", words, "status says what leads on")
    return {"would": would}


def _runs(mode: Mode) -> str:
    """From when on a law runs that is put in place in that mode."""
    return "from the next tick" if mode in (Mode.active, Mode.hold) else f"after arm: the mode is {mode.name}"


def _swap(robot: Robot, args: Json, mode: Mode, tier: Tier) -> Json:
    try:
        args = {key: value for key, value in args.items() if key not in ("brief", "wait")}
        robot.call("swap", **args, fenced=tier < Tier.person, dry_run=True)
    except Refused as end:
        if end.code != "dry_run":
            raise
        certificate: Any = end.detail.get("swap") or {}
        trial = certificate.get("trial") or {}
        found = {key: trial[key] for key in ("hints", "warnings") if trial.get(key)}
        beside = f"beside the running law for {args['shadow_s']:g} s, without effect" if args.get("shadow_s") else ""
        then = f"it would run {_runs(mode)}"
        if beside:
            never = args.get("promote") is False
            then = f"it would compute {beside}, and {'never run' if never else 'run after that'}"
        return {"would": f"the law passed compiler, admission and trial; {then}", **found}
    raise Refused("error", "the supervisor does not know dry_run", "build both from the same source")


def _check_follows(mode: Mode) -> None:
    if mode is not Mode.active:
        raise refused_in(mode)


def _check_plan(references: References, args: Json) -> None:
    limits = references.limits()
    rows = np.atleast_2d(np.asarray(args["position_rad"], dtype=np.float64))
    if rows.shape != (len(args["t_ns"]), len(limits.names)):
        raise Refused("refused_plan", f"position_rad has the shape {rows.shape}", "a row for each time, all joints")
    for joint, name in enumerate(limits.names):
        for value in rows[:, joint]:
            if not limits.least_rad[joint] <= value <= limits.most_rad[joint]:
                least, most = limits.least_rad[joint], limits.most_rad[joint]
                words = f"joint '{name}': {value:.3f} rad, its limits are {least:.3f} and {most:.3f} rad"
                raise Refused("refused_plan", words, "keep waypoints inside the limits")


def _goes_back(resident: list[Json], verb: str, args: Json, mode: Mode) -> Json:
    running = next((law["law_id"] for law in resident if law["active"]), 0)
    earlier = sorted((law for law in resident if law["law_id"] <= running), key=lambda law: -int(law["law_id"]))
    back, to = earlier[1:], None
    if verb == "rollback":
        steps = int(args.get("steps", 1))
        if not 1 <= steps <= len(back):
            raise Refused("refused_law", f"there are {len(back)} laws to go back to", _listed(back))
        to = back[steps - 1]
    else:
        to = next((law for law in earlier if args.get("law") in (law["law"], law["law_id"])), None)
    if to is None:
        raise Refused("unknown_law", f"no law {args.get('law')!r} ran before and is loaded", _listed(back))
    dropped = [{key: law[key] for key in ("law", "law_id", "source") if law.get(key)}
               for law in earlier if law["law_id"] > to["law_id"]]  # fmt: skip
    gone = f"; the {len(dropped)} after it are dropped: no rollback leads to them" if dropped else ""
    runs = f"law '{to['law']}' (law_id {to['law_id']}) runs {_runs(mode)}, with its state"
    return {"would": runs + gone, "law_id": to["law_id"], "dropped": dropped}


def _listed(laws: list[Json]) -> str:
    names = ", ".join(f"{law['law_id']} ('{law['law']}')" for law in laws)
    return f"one of these law_id: {names}" if names else "swap its text: no earlier law is loaded"
