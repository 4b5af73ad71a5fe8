# SPDX-License-Identifier: Apache-2.0
"""Every verb that the gateway offers: its arguments as JSON Schema, what it does, and what it may do to the robot.

`describe`, the gateway's order of service and the tools of `lithe.mcp` all come from this one table.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum
from typing import Any

Schema = dict[str, Any]


class Effect(Enum):
    """What a verb may do to the robot."""

    reads = "reads"
    claims = "claims"  # it changes who may move the robot
    stops = "stops"  # it stops the robot, or goes back to a law or values that ran before
    moves = "moves"  # the robot may move after it, otherwise than before


class Tier(IntEnum):
    """What a client may do; each includes those before it. What stops the robot needs none."""

    observe = 0  # read, and stop
    tune = 1  # change parameters of the running law
    swap = 2  # change the law, within the robot file's fences
    move = 3  # move the joints, and change the mode
    person = 4  # beyond the robot file's fences; the simulated plant; shut down; take the torque off without braking


@dataclass(frozen=True)
class Verb:
    """`first`: handled ahead of what only reads. `required`: arguments that must be there. `commands`: of `lithe`,
    those that do the same, but for the verb's own words. `tier`: who may use it at least, but for what tier_of() says.
    """

    name: str
    what: str
    effect: Effect = Effect.reads
    args: dict[str, Schema] = field(default_factory=dict)
    required: tuple[str, ...] = ()
    first: bool = False
    commands: tuple[str, ...] = ()
    tier: Tier = Tier.observe

    def schema(self) -> Schema:
        """The arguments, as one JSON Schema."""
        return {
            "type": "object",
            "properties": self.args,
            "required": list(self.required),
            "additionalProperties": False,
        }

    def described(self) -> dict[str, Any]:
        """What `describe` says of it."""
        return {
            "verb": self.name,
            "what": self.what,
            "effect": self.effect.value,
            "tier": self.tier.name,
            "args": self.schema(),
        }


def _of(kind: str) -> Callable[..., Schema]:
    """Makes schemas of that type: what it is, and more of JSON Schema's words."""
    return lambda what, **more: {"type": kind, "description": what, **more}


def _list(of: Schema, what: str, **more: Any) -> Schema:
    return {"type": "array", "items": of, "description": what, **more}


_number, _integer, _text, _flag = (_of(kind) for kind in ("number", "integer", "string", "boolean"))
_VALUES: Schema = {
    "type": "object",
    "description": "parameter name -> value; all are set in one tick, or none",
    "additionalProperties": {"type": "number"},
}
_FIELDS = _list(
    {"type": "string"},
    "telemetry fields, as in the document telemetry; sample_age_s; error_rad (setpoint minus position, both of the "
    "sample's time); a wrong name is refused with the list of all",
)
_BRIEF = _flag("false: the whole (default true)")
_ARM = {"all_the_same": _flag("true: also a law that has stopped the robot")}
_NUMBERS: Schema = {"type": "array", "items": {"type": "number"}}
_ROW: Schema = {"anyOf": [_NUMBERS, {"type": "number"}]}  # a number: of the only joint
_EACH: Schema = {"description": "one number for all joints, or one for each", "anyOf": [{"type": "number"}, _NUMBERS]}
_LAW = {
    "source": _text("the whole law: C++ that includes <lithe/law.hpp>"),
    "name": _text("of its text, in diagnostics and as `source`: pd.cpp; the law's own name is in LITHE_LAW"),
}
_TERMS = {
    "shadow_s": _number("first computes beside the running law for this time", minimum=0),
    "budget_us": _number("longest step", exclusiveMinimum=0),
    "box_ms": _number("time of the trial", exclusiveMinimum=0),
    "brief": _flag("true (default): less than 2 kB; the certificate is the document it names. false: the whole"),
}
_WAYPOINTS = _list(_ROW, "one row per waypoint, one number per joint", maxItems=16)

_VERBS = (
    Verb(
        "describe",
        "The robot: rate, joints with limits and drives, sensors, documents, time; over TCP also every verb. With "
        "`verb`: only what that verb does, and its arguments in full.",
        args={"verb": _text("its name")},
    ),
    Verb("sim_truth", "The simulated plant as its file states it: inertia, friction, delay, seed.", tier=Tier.person),
    Verb("ping", "The supervisor's process id."),
    Verb(
        "status",
        "Mode, fault, law, alarms, joints and drives with their problems.",
        args={"brief": _BRIEF},
        commands=("top",),
    ),
    Verb(
        "events",
        "What happened: events with kind and text, the newest last, as many as fit; missed deadlines in a row are one "
        "event with `count`.",
        args={
            "since": _integer("the cursor of an earlier answer: those after it, the oldest first", minimum=0),
            "limit": _integer("at most so many; without since, the newest", minimum=1),
            "kind": {
                "description": "only this kind, or these",
                "anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}],
            },
        },
    ),
    Verb(
        "incidents",
        "The faults, rollbacks and changes of mode that were recorded.",
        commands=("incident list",),
    ),
    Verb(
        "incident",
        "One of them: what happened. Extremes of each joint, the events of that time, the file of its telemetry.",
        args={"id": _integer("its number; 0 or left out: the newest", minimum=0)},
        commands=("incident show",),
    ),
    Verb("latest", "The newest telemetry record.", args={"fields": _FIELDS, "brief": _BRIEF}),
    Verb(
        "history",
        "Columns of telemetry. Every tick of the last 4096, and before them every 20th of the last 60 s (`thinned`). "
        "A tool's answer has at most 65536 bytes, about 5000 numbers: choose fields and joints; else ticks are left "
        "out, and `every` says so.",
        args={
            "seconds": _number("how far back", exclusiveMinimum=0, maximum=60),
            "since_tick": _integer("only ticks after this one", minimum=0),
            "until_tick": _integer("no ticks after this one", minimum=0),
            "every": _integer("only ticks that it divides", minimum=1),
            "incident": _integer("instead: the ticks kept around this incident, from 1 s before", minimum=1),
            "joints": _list({"type": "string"}, "names; columns of these only"),
            "fields": _FIELDS,
            "brief": _BRIEF,
        },
    ),
    Verb(
        "measure",
        "How well the running law follows, by joint. Law and parameters, each joint's error (rms, median, largest and "
        "its tick) and torque, missed ticks, for how long no plan was followed, in which share of the ticks the guard "
        "changed a joint's torque, with the flags of these ticks. Mode active only. `law_changed`: the law or its "
        "parameters changed since your last call, why, and what leads back.",
        args={"seconds": _number("how far back (default 4)", exclusiveMinimum=0, maximum=60)},
    ),
    Verb(
        "identify",
        "The robot's parameters (inertia, gravity, friction; of a chain all links at once), each with its 95 % "
        "interval, from the last seconds in mode active. Where they tell too little: `needs`, a motion that does.",
        args={"seconds": _number("how far back (default 4); the Spine has 4096 ticks", exclusiveMinimum=0)},
    ),
    Verb("state", "The running law's State, name -> value."),
    Verb("documents", "What there is to read. The contract of a law, rules, usual mistakes, laws, swaps so far."),
    Verb(
        "document",
        "The text of one of them.",
        args={"name": _text("as documents lists it: contract, rules, mistakes, swaps, swaps/0007.cpp ...")},
        required=("name",),
        commands=("law show",),
    ),
    Verb("params", "The running law's parameters: value, min, max.", commands=("param get",)),
    Verb("law_list", "The loaded laws, which one runs, and how well each followed."),
    Verb(
        "law_check",
        "Compiles a law and runs it on harmless inputs. Nothing reaches the robot. `swap` with `promote: false` tries "
        "the law in simulation as well, and leaves the running law.",
        args=_LAW,
        required=("source",),
    ),
    Verb(
        "swap",
        "Replaces the running law, if the new one passes all checks. Returns the certificate; "
        "with wait, when the probation is over: verdict, rms errors of old and new law (`new` with the first second, "
        "in which the joints come to the setpoint; `new_late` without; later `measure`), why it was rolled back.",
        Effect.moves,
        args={
            **_LAW,
            "params": _VALUES,
            "supersede": _flag("replaces this client's older waiting request of this name"),
            "blend_s": _number("from the old torque to the new one's", minimum=0),
            "probation_s": _number("automatic rollback during this time", minimum=0),
            "error_ratio": _number("how much worse tracking may get before the rollback", minimum=0),
            **_TERMS,
            "shadow_tolerance_nm": _number("how far it may differ meanwhile", minimum=0),
            "promote": _flag("false: it is only compared, for shadow_s, and never runs"),
            "wait": _flag("true (the default with brief: true): answers when its probation is over; false: at once"),
        },
        required=("source",),
        commands=("swap hold",),
        tier=Tier.swap,
    ),
    Verb(
        "shadow",
        "Compares a law with the running one; it never runs. Default of shadow_s: 2. `shadow_rms_nm`, "
        "`shadow_most_nm`: joint -> by how much its torque differs [N m].",
        Effect.moves,
        args={**_LAW, "params": _VALUES, **_TERMS},
        required=("source",),
        tier=Tier.swap,
    ),
    Verb(
        "lease",
        "Who has the right to move the robot; with take: true, this client takes it, and others are refused (leased).",
        Effect.claims,
        args={
            "take": _flag("true: take or prolong it; false: give it back"),
            "seconds": _number("it ends so long after the holder's last moving verb", exclusiveMinimum=0, maximum=600),
        },
    ),
    Verb(
        "set_params",
        "Changes parameters of the running law, after a trial. With wait, the answer says which of them went back.",
        Effect.moves,
        args={
            "values": _VALUES,
            "name": _text("of one parameter"),
            "value": _number("its value"),
            "wait": _flag("true: answers when their probation is over, in short"),
        },
        first=True,
        commands=("param set",),
        tier=Tier.tune,
    ),
    Verb(
        "publish",
        "A plan: up to 16 waypoints that the Spine follows.",
        Effect.moves,
        args={
            "t_ns": _list({"type": "integer"}, "CLOCK_MONOTONIC, ns; see describe.now_ns"),
            "position_rad": _WAYPOINTS,
            "velocity_rad_s": _WAYPOINTS,
            "streaming": _flag("more plans follow: the last waypoint is passed, not a rest"),
            "interpolation": _text("hold: the setpoint steps to each waypoint at its time", enum=["cubic", "hold"]),
        },
        required=("t_ns", "position_rad"),
        first=True,
        tier=Tier.move,
    ),
    Verb(
        "set_inputs",
        "Numbers for the running law beside the plan (`describe.inputs`); the others stay.",
        Effect.moves,
        args={"values": {**_VALUES, "description": "input name -> number in its range; {}: only keeps them fresh"}},
        required=("values",),
        first=True,
        tier=Tier.move,
    ),
    Verb(
        "set_reference",
        "Streams a reference from now on; faded in from where the joints are, checked against their limits first. "
        "`warning`: what is still on probation, and may go back by this motion.",
        Effect.moves,
        args={
            "kind": {"type": "string", "enum": ["rest", "steps", "sine", "multisine", "chirp", "waypoints"]},
            "centre_rad": _EACH,
            "amplitude_rad": _EACH,
            "phase_rad": _EACH,
            "frequency_hz": {**_EACH, "description": "sine: one, or one for each joint; multisine: up to 64"},
            "from_hz": _number("chirp: its first frequency", exclusiveMinimum=0),
            "to_hz": _number("chirp: its last frequency", exclusiveMinimum=0),
            "duration_s": _number("chirp: its length", exclusiveMinimum=0),
            "t_s": _list({"type": "number"}, "waypoints: ascending times"),
            "position_rad": _list(_ROW, "steps, waypoints: rows of one number per joint", maxItems=1000),
            "every_s": _number("steps: from one to the next", exclusiveMinimum=0),
            "rise_s": _number("steps: how long a step takes", exclusiveMinimum=0),
            "ramp_s": _number("how long it takes to fade in", exclusiveMinimum=0),
            "stay": _flag("it goes on when this client leaves or is silent"),
            "client_stale_s": _number("silence of this client after which it ends (default 5)", exclusiveMinimum=0),
        },
        required=("kind",),
        first=True,
        commands=("move", "jog"),
        tier=Tier.move,
    ),
    Verb("reference", "The reference that is streamed. Since when, its interruptions, and why the one before ended."),
    Verb("stop_reference", "The reference comes to rest.", Effect.stops, first=True),
    Verb("arm", "Torque on: the law runs from the next tick.", Effect.moves, args=_ARM, first=True, tier=Tier.move),
    Verb("recover", "Brings joints back inside their limits, slowly.", Effect.moves, first=True, tier=Tier.move),
    Verb("reset", "Clears e-stop or safe stop; the robot is disarmed then.", Effect.moves, first=True, tier=Tier.move),
    Verb("sim_reset", "Disarmed simulated robots: the joints go back to their start.", Effect.moves, tier=Tier.move),
    Verb(
        "hold",
        "The setpoint slows down and rests; the law runs and keeps it there, until `arm`. No plan is followed.",
        Effect.stops,
        first=True,
    ),
    Verb(
        "disarm",
        "Torque off, once moving joints are braked to rest. `what`: what happened.",
        Effect.stops,
        args={"now": _flag("true: at once, a moving joint coasts; for a person")},
        first=True,
    ),
    Verb("estop", "At once: the drives damp until `reset`.", Effect.stops, first=True),
    Verb(
        "rollback",
        "An earlier law runs again, with its state. The answer has the law that it left, and those that are gone.",
        Effect.stops,
        args={"steps": _integer("how many laws back", minimum=1, maximum=4)},
        first=True,
        tier=Tier.swap,
    ),
    Verb(
        "activate",
        "A law that ran before (law_list) runs again; those after it are lost. The answer lists "
        "them as `dropped`. It runs with its state. Of several with that name: the newest.",
        Effect.stops,
        args={"law": {"description": "its name, or its law_id", "anyOf": [{"type": "string"}, {"type": "integer"}]}},
        required=("law",),
        first=True,
        commands=("law activate",),
        tier=Tier.swap,
    ),
    Verb(
        "revert_params",
        "The parameters before the last change.",
        Effect.stops,
        first=True,
        commands=("param revert",),
        tier=Tier.tune,
    ),
    Verb("shutdown", "Stops robot and supervisor in order.", Effect.moves, commands=("stop",), tier=Tier.person),
)
_DRY = {"dry_run": _flag("true: what would happen, or why it would be refused; nothing changes")}
VERBS = tuple(
    each
    if each.effect in (Effect.reads, Effect.claims) or each.name == "estop"
    else replace(each, args={**each.args, **_DRY})
    for each in _VERBS
)
BY_NAME = {each.name: each for each in VERBS}


def tier_of(verb: Verb, args: dict[str, Any]) -> Tier:
    """Who may use it with these arguments."""
    if args.get("dry_run") and "dry_run" in verb.args:
        return Tier.observe
    if verb.name == "disarm" and args.get("now"):
        return Tier.person
    takes = verb.name == "lease" and (args.get("take") or "seconds" in args)  # it keeps others from moving
    return Tier.tune if takes else verb.tier


_BY_COMMAND = {words: each.name for each in VERBS for words in (each.name.replace("_", " "), *each.commands)}
# These need the robot's computer: no verb does the same.
_OTHER_COMMANDS = (
    "run", "list", "law", "law verify", "param", "param save", "bus", "bus [a-z]+", "tune", "tune [a-z]+", "doctor",
    "sim", "help", "agent", "mcp", "evolve", "identify", "model",
)  # fmt: skip
_ANY = "|".join(sorted([*_BY_COMMAND, *_OTHER_COMMANDS], key=len, reverse=True))
_COMMAND = re.compile(rf"`?\blithe ({_ANY})\b((?: \S+[.]toml\b| --[a-z-]+)*)`?")


def in_verbs(text: str) -> str:
    """Words that are meant for a terminal, for clients that have verbs only: "lithe law list" -> "law_list"."""

    def verb(found: re.Match[str]) -> str:
        name = _BY_COMMAND.get(found[1])
        return name + found[2] if name else f"{found[1]}{found[2]} (on the robot's computer)"

    return _COMMAND.sub(verb, text) if "lithe " in text else text


def nearest(name: str, known: Iterable[str]) -> str:
    """What to do about a wrong name: the nearest right one, and all."""
    known = sorted(known)
    near = difflib.get_close_matches(name, known, 1)
    return (f"did you mean '{near[0]}'? " if near else "") + f"one of: {', '.join(known)}"
