# SPDX-License-Identifier: Apache-2.0
"""The gateway's documents as resources, and prompts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

Json = dict[str, Any]
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
    """For resources/list: what the gateway has."""
    return [
        {
            "uri": SCHEME + each["name"],
            "name": each["name"].removeprefix("laws/"),
            "mimeType": each["type"],
            "description": each["what"],
        }
        for each in call("documents", {})["documents"]
    ]


def read(uri: str, call: Callable[[str, Json], Any]) -> tuple[str, str]:
    """Its type and text. KeyError: there is no such resource."""
    if not uri.startswith(SCHEME):
        raise KeyError(uri)
    found = call("document", {"name": uri.removeprefix(SCHEME)})
    return str(found["type"]), str(found["text"])


def prompts() -> list[Json]:
    """For prompts/list."""
    about = [{"name": "about", "description": "more words: the refusal, the goal", "required": False}]
    return [{"name": name, "description": words, "arguments": about} for name, (words, _) in PROMPTS.items()]


def prompt(name: str, args: Json) -> Json:
    """For prompts/get. KeyError: there is none of that name."""
    words, text = PROMPTS[name]
    text += f"\n\n{args['about']}" if args.get("about") else ""
    return {"description": words, "messages": [{"role": "user", "content": {"type": "text", "text": text}}]}
