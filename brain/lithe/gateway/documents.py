# SPDX-License-Identifier: Apache-2.0
"""What an agent can read without the robot's files: the contract of a law, rules, laws that come with LITHE, swaps."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..errors import Refused
from ..programs import ROOT
from ..vocabulary import nearest
from .answers import Verbatim
from .brief import brief

Json = dict[str, Any]
LAWS = ROOT / "laws"
DOCS = ROOT / "docs"
WIRE = DOCS / "reference/wire.md"
CONTRACT = ROOT / "spine/law/include/lithe/law.hpp"
CPP, MARKDOWN, JSON = "text/x-c++src", "text/markdown", "application/json"
MOST_SWAPS_BYTES = 32 << 10
KEPT = (
    "; the texts of the newest 256 swaps are kept, and those of laws that are loaded or ran "
    "since the supervisor started"
)
OF_A_SWAP = re.compile(r"swaps/([0-9]{1,9})(\.cpp)?")
FIXED = {
    "contract": (CPP, "the header that every law includes", CONTRACT),
    "rules": (MARKDOWN, "what a law may use, and how it is tried", DOCS / "laws.md"),
    "mistakes": (MARKDOWN, "what LITHE says of usual mistakes, and what to write instead", DOCS / "mistakes.md"),
    "swapping": (MARKDOWN, "what a swap judges, its terms, probation, and the ways back", DOCS / "swapping.md"),
    "agents": (MARKDOWN, "references, swaps and parameters for agents, step by step", DOCS / "agents.md"),
    "verbs": (MARKDOWN, "every verb and every code of a refusal", DOCS / "reference/verbs.md"),
    "swap_details": (MARKDOWN, "how a law is swapped, and what is not contained", DOCS / "swap.md"),
    "telemetry": (MARKDOWN, "every field of a tick with its unit, and the names of its numbers", WIRE),
    "wire": (MARKDOWN, "shared memory: every message, byte by byte", WIRE),
    "plants": (MARKDOWN, "what a simulated robot contains: delays, model errors", DOCS / "reference/plants.md"),
    "chain": (MARKDOWN, "the equations of a chain of links, for a law that compensates", DOCS / "reference/chain.md"),
    "faults": (MARKDOWN, "each fault, what it means and what leads back", DOCS / "reference/faults.md"),
}


def listed() -> list[Json]:
    """Name, media type and a sentence of each."""
    laws = [(f"laws/{path.name}", CPP, "a law that comes with LITHE") for path in sorted(LAWS.glob("*.cpp"))]
    swaps = (
        "the last swaps of this robot: verdict, error, joints; swaps/0007: the whole certificate of swap 7, "
        "swaps/0007.cpp: its law"
    )
    all_of_them = [(name, kind, what) for name, (kind, what, _) in FIXED.items()] + [("swaps", JSON, swaps), *laws]
    return [{"name": name, "type": kind, "what": what} for name, kind, what in all_of_them]


def read(name: str, records: Callable[[], Path], joints: Sequence[str] = ()) -> Json:
    """`name`, `type` and `text` of one. Refused: there is none of that name. `records`: the folder of certificates;
    `joints`: the robot's, in order.
    """
    kinds = {each["name"]: each["type"] for each in listed()}
    if swap := OF_A_SWAP.fullmatch(name):
        kinds[name] = CPP if swap[2] else JSON
    if name not in kinds:
        raise Refused("unknown_document", f"there is no document '{name}'", nearest(name, kinds))
    if name == "swaps":
        return {"name": name, "type": kinds[name], "text": json.dumps(swaps(records(), joints))}
    path = FIXED[name][2] if name in FIXED else LAWS / name.removeprefix("laws/")
    if swap:
        path = records() / f"{swap[1]}{swap[2] or '.json'}"
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        words = f"cannot read {path.name}: {error.strerror}" + (KEPT if swap and swap[2] else "")
        raise Refused("unknown_document", words, "documents lists those that are there") from None
    if name == "telemetry":
        text = fields_of_a_tick(text)
    return Verbatim({"name": name, "type": kinds[name], "text": text})


def fields_of_a_tick(wire: str) -> str:
    """Of the page of shared memory what a reader of telemetry needs: the fields without offsets, and named numbers."""
    rows = wire.partition("### `Telemetry`")[2].partition("\n### ")[0].splitlines()
    cells = [[each.strip() for each in row.strip("|").split("|")] for row in rows if row.startswith("|")]
    table = ["| " + " | ".join((name, unit, kind, what)) + " |" for name, kind, unit, _, what in cells]
    numbers = wire.partition("## Numbers with names")[2]
    return (
        "# Telemetry: one record per tick\n\n[NJ]: one entry for each joint, in the order of `describe`; [NS]: for "
        "each sensor. `latest` and `history` give only those that there are.\n\n"
        + "\n".join(table)
        + f"\n\n## Numbers with names{numbers}"
    )


def swaps(folder: Path, joints: Sequence[str] = ()) -> list[Json]:
    """The newest certificates of a folder in short, as many as fit, the oldest first; unreadable ones are left out."""
    told: list[Json] = []
    left_bytes = MOST_SWAPS_BYTES - 2
    for path in sorted(folder.glob("[0-9]*.json"), key=lambda each: (len(each.name), each.name), reverse=True):
        try:
            one = brief(json.loads(path.read_text(encoding="utf-8")) | {"certificate": path.name}, joints)
        except (OSError, ValueError, TypeError, AttributeError):
            continue
        left_bytes -= len(json.dumps(one)) + 2
        if left_bytes < 0:
            break
        told.append(one)
    return told[::-1]
