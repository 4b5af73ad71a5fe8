# SPDX-License-Identifier: Apache-2.0
"""What an agent can read: the contract of a law, the laws that come with LITHE, the swaps so far; and prompts."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..programs import ROOT

Json = dict[str, Any]
CONTRACT = ROOT / "spine/law/include/lithe/law.hpp"
LAWS = ROOT / "laws"
RULES = ROOT / "docs/laws.md"
CPP, MARKDOWN, JSON = "text/x-c++src", "text/markdown", "application/json"
MOST_SWAPS = 100

PROMPTS = {
    "identify_then_compensate": (
        "Measure the robot, find its parameters, write a law that compensates them.",
        "Read lithe://contract and lithe://rules. Move every joint within its limits (`publish`) and fetch `history` "
        "with setpoint, position, velocity and torque. Estimate inertia, friction and gravity of each joint. Write a "
        "law that adds what you found to a feedback; `law_check` it, then `swap` it. Compare the tracking error "
        "before and after, per joint, and `rollback` if any joint became worse.",
    ),
    "explain_this_refusal": (
        "Say why a law was refused and what to change.",
        "Explain in three sentences why this was refused, which line or value is the cause, and the smallest change "
        "that would pass. Use lithe://contract and lithe://rules. The refusal:",
    ),
    "improve_by_one_term": (
        "Make the running law better by one term.",
        "Fetch `history` of the last seconds and find the joint with the largest tracking error. Add exactly one term "
        "to your last law that reduces this error, and say why it does. `swap` it, compare, and keep it only if no "
        "joint became worse.",
    ),
}


def _templates() -> dict[str, Path]:
    return {f"lithe://laws/{path.name}": path for path in sorted(LAWS.glob("*.cpp"))}


def resources() -> list[Json]:
    """For resources/list."""
    fixed = [
        ("lithe://contract", "contract", CPP, "the header that every law includes"),
        ("lithe://rules", "rules", MARKDOWN, "what a law may use, and how it is tried"),
        (
            "lithe://swaps",
            "swaps",
            JSON,
            f"the last {MOST_SWAPS} swaps of this robot: law, verdict, terms, what was measured",
        ),
    ]
    laws = [(uri, path.name, CPP, "a law that comes with LITHE") for uri, path in _templates().items()]
    return [
        {"uri": uri, "name": name, "mimeType": mime, "description": words} for uri, name, mime, words in fixed + laws
    ]


def read(uri: str, call: Callable[[str, Json], Any]) -> tuple[str, str]:
    """Its type and text. KeyError: there is no such resource."""
    if uri == "lithe://swaps":
        return JSON, json.dumps(swaps(Path(call("status", {})["records"])))
    files = {"lithe://contract": (CPP, CONTRACT), "lithe://rules": (MARKDOWN, RULES)}
    files |= {each: (CPP, path) for each, path in _templates().items()}
    mime, path = files[uri]
    return mime, path.read_text(encoding="utf-8")


def swaps(folder: Path) -> list[Json]:
    """The certificates of a folder, the oldest first; what cannot be read is left out."""
    told = []
    for path in sorted(folder.glob("[0-9]*.json"))[-MOST_SWAPS:]:
        try:
            one = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            continue
        told.append({"certificate": path.name, **{key: one[key] for key in SHOWN if key in one}})
    return told


SHOWN = ("law", "source", "source_sha256", "verdict", "reason", "params", "terms", "measured", "rolled_back")


def prompts() -> list[Json]:
    """For prompts/list."""
    about = [{"name": "about", "description": "more words: the refusal, the goal", "required": False}]
    return [{"name": name, "description": words, "arguments": about} for name, (words, _) in PROMPTS.items()]


def prompt(name: str, args: Json) -> Json:
    """For prompts/get. KeyError: there is none of that name."""
    words, text = PROMPTS[name]
    text += f"\n\n{args['about']}" if args.get("about") else ""
    return {"description": words, "messages": [{"role": "user", "content": {"type": "text", "text": text}}]}
