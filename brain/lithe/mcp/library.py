# SPDX-License-Identifier: Apache-2.0
"""The gateway's documents and the plots as resources, and prompts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..errors import Refused
from . import plots
from .protocol import Json

SCHEME = "lithe://"

READ = (
    "What begins with lithe:// is a resource; the tool `document` gives the same by the name behind it. When a tool "
    "answers no_permission, ask the person for it and wait; nothing else helps.\n\n"
)
SWAP = (
    "`law_check` the law, then `swap` it while the reference runs: at rest no law is confirmed. The answer of `swap` "
    "has the verdict and, per joint, the rms error of old and new law; lithe://plots/last-swap.png shows them, "
    "lithe://swaps has those of all swaps. `rollback` if a joint became worse. At the end `stop_reference`."
)
MOVE = (
    "`describe` has the joints and their limits. Move every joint within them: `set_reference` (kind multisine, with "
    "centre_rad, amplitude_rad, four or more values of frequency_hz from 0.2 to 3, and client_stale_s 900, so that it "
    "goes on while you think). "
)
PROMPTS = {  # its words, what `about` is, its text
    "identify_then_compensate": (
        "Measure the robot, find its parameters, write a law that compensates them.",
        "the goal, or what is known of the robot",
        "Read lithe://contract and lithe://rules. " + MOVE + "After 10 s ask `identify`: it has the parameters "
        "(inertia, gravity, friction), each with its interval, and their model; lithe://chain has the equations of a "
        "chain. Where it refuses, set the reference that it needs, and ask again. "
        "Do not trust a value that is negative, that changes much between two windows, or of a joint "
        "that hardly moved. Where you cannot compute, take one term after "
        "another by its sign and size, and let `measure` judge it. Write a law that adds these torques, at the "
        "setpoint's acceleration and velocity and at the position, to a feedback of position and velocity. " + SWAP,
    ),
    "explain_this_refusal": (
        "Say why a law was refused and what to change.",
        "the refusal, as a tool answered it; left out: the newest in lithe://swaps",
        "Explain in three sentences why this was refused, which line or value is the cause, and the smallest change "
        "that would pass. Use lithe://contract, lithe://rules and lithe://mistakes. Where no refusal follows, take the "
        "newest of lithe://swaps that has an error or rolled_back; lithe://swaps/NUMBER.cpp is its law, if it ran. "
        "Then try your change by `swap` with dry_run true: it compiles it and runs the trial, and changes nothing.",
    ),
    "improve_by_one_term": (
        "Make the running law better by one term.",
        "the goal, or the joint that matters",
        "Read lithe://contract, and the running law: `status` has its name, lithe://swaps its swap, "
        "lithe://swaps/NUMBER.cpp its text; a law that came with the robot is lithe://laws/NAME.cpp. `reference` says "
        "whether a reference runs. If none does: " + MOVE + "`measure` has each joint's error and torque; "
        "lithe://plots/recent.png shows when the error is large: at a constant speed (friction), far from hanging "
        "(gravity), at a change of speed (inertia), as a constant (an integral). Add exactly one term that reduces the "
        "largest error, and say why it does. " + SWAP,
    ),
}


def resources(call: Callable[[str, Json], Any]) -> list[Json]:
    """For resources/list: what the gateway has, and what can be drawn of it."""
    named = [(each["name"], each["type"], each["what"]) for each in call("documents", {})["documents"]]
    named += [(name, plots.TYPE, what) for name, what in plots.ALWAYS.items()]
    return [
        {"uri": SCHEME + name, "name": name.removeprefix("laws/"), "mimeType": kind, "description": what}
        for name, kind, what in named
    ]


def templates() -> list[Json]:
    """For resources/templates/list: of one swap or incident."""
    return [
        {"uriTemplate": SCHEME + name, "name": name, "mimeType": kind, "description": what}
        for name, kind, what in (
            ("swaps/{number}", "application/json", "the whole certificate of a swap; {number} as in lithe://swaps"),
            ("swaps/{number}.cpp", "text/x-c++src", "the law of that swap"),
            *((name, plots.TYPE, what) for name, what in plots.OF_ONE.items()),
        )
    ]


def read(uri: str, call: Callable[[str, Json], Any]) -> Json:
    """Its mimeType, and its text or blob. Refused: there is no such resource."""
    if not uri.startswith(SCHEME):
        raise Refused("unknown_document", f"its scheme is not {SCHEME}")
    name = uri.removeprefix(SCHEME)
    if plots.is_one(name):
        return {"mimeType": plots.TYPE, "blob": plots.drawn(name, call)}
    found = call("document", {"name": name})
    return {"mimeType": str(found["type"]), "text": str(found["text"])}


def prompts() -> list[Json]:
    """For prompts/list."""
    return [
        {"name": name, "description": words, "arguments": [{"name": "about", "description": about, "required": False}]}
        for name, (words, about, _) in PROMPTS.items()
    ]


def prompt(name: str, args: Json) -> Json:
    """For prompts/get. KeyError: there is none of that name."""
    words, of, text = PROMPTS[name]
    text = READ + text + (f"\n\nGiven ({of.partition(',')[0]}):\n\n{args['about']}" if args.get("about") else "")
    return {"description": words, "messages": [{"role": "user", "content": {"type": "text", "text": text}}]}
