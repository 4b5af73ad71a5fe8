# SPDX-License-Identifier: Apache-2.0
"""The gateway's documents and the plots as resources, and prompts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..errors import Refused
from . import plots
from .protocol import Json

SCHEME = "lithe://"

PROMPTS = {
    "identify_then_compensate": (
        "Measure the robot, find its parameters, write a law that compensates them.",
        "Read lithe://contract and lithe://rules. Move every joint within its limits: `set_reference` (kind multisine, "
        "client_stale_s 900, so that it goes on while you think). Fetch `history` with setpoint, position, velocity "
        "and torque. Estimate inertia, friction and gravity of each joint. Write a law that adds what you found to a "
        "feedback; `law_check` it, then `swap` it while the reference runs: at rest no law is confirmed. The answer of "
        "`swap` has the verdict and, per joint, the rms error of old and new law; lithe://swaps has those of all "
        "swaps. `rollback` if any joint became worse, and `stop_reference` at the end.",
    ),
    "explain_this_refusal": (
        "Say why a law was refused and what to change.",
        "Explain in three sentences why this was refused, which line or value is the cause, and the smallest change "
        "that would pass. Use lithe://contract and lithe://rules. The refusal:",
    ),
    "improve_by_one_term": (
        "Make the running law better by one term.",
        "While a reference runs (`reference`; `set_reference` with client_stale_s 900 starts one), fetch `history` of "
        "the last seconds and find the joint with the largest tracking error. Add exactly one term to your last law "
        "that reduces this error, and say why it does. `swap` it: its answer has the verdict and, per joint, the rms "
        "error of old and new law. `rollback` if a joint became worse.",
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
    about = [{"name": "about", "description": "more words: the refusal, the goal", "required": False}]
    return [{"name": name, "description": words, "arguments": about} for name, (words, _) in PROMPTS.items()]


def prompt(name: str, args: Json) -> Json:
    """For prompts/get. KeyError: there is none of that name."""
    words, text = PROMPTS[name]
    text += f"\n\n{args['about']}" if args.get("about") else ""
    return {"description": words, "messages": [{"role": "user", "content": {"type": "text", "text": text}}]}
