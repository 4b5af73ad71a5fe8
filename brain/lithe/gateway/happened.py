# SPDX-License-Identifier: Apache-2.0
"""The gateway's verb `events`: as many as fit into one answer. Threads: pure functions."""

from __future__ import annotations

import json
from typing import Any

Json = dict[str, Any]
MOST_BYTES = 40 << 10  # an answer of MCP has 64 KiB at most
RUNS = ("deadline_missed",)  # kinds that come in runs


def asked(args: Json) -> Json:
    """The arguments for the supervisor, which has neither kinds nor runs: all of its events."""
    return {"since": int(args["since"])} if "since" in args else {}


def told(answer: Json, args: Json) -> Json:
    """Of the supervisor's events: only of the kinds in `kind` (one or a list), runs of one kind as one with `count`.

    With `since` the oldest that fit, and `cursor` goes on from there; without it the newest. `left_out`: how many of
    the others were not told.
    """
    kinds = args.get("kind") or []
    wanted = {kinds} if isinstance(kinds, str) else set(kinds)
    all_of_them = _runs([each for each in answer["events"] if not wanted or each["kind"] in wanted])
    forward = "since" in args
    most = int(args.get("limit", len(all_of_them)))
    kept: list[Json] = []
    left_bytes = MOST_BYTES
    for each in all_of_them if forward else reversed(all_of_them):
        left_bytes -= len(json.dumps(each)) + 2
        if left_bytes < 0 or len(kept) >= most:
            break
        kept.append(each)
    left_out = len(all_of_them) - len(kept)
    cursor = answer["cursor"]
    if forward and left_out:
        cursor = _end(kept[-1]) if kept else int(args["since"])
    if wanted and not all_of_them:
        there = sorted({each["kind"] for each in answer["events"]})
        none = f"no event has the kind {' or '.join(sorted(map(str, wanted)))}; there are: {', '.join(there)}"
        return {"events": [], "cursor": cursor, "lost": answer["lost"], "next": none}
    return {"events": kept if forward else kept[::-1], "cursor": cursor, "lost": answer["lost"]} | (
        {"left_out": left_out, "next": _more(forward)} if left_out else {}
    )


def _more(forward: bool) -> str:
    return "ask again with since = cursor" if forward else "kind chooses; since = 0 begins with the oldest"


def _end(event: Json) -> int:
    return int(event["until_cursor"] if "until_cursor" in event else event["cursor"])


def _runs(events: list[Json]) -> list[Json]:
    """Each run of one kind of RUNS becomes its first event, with `count` and where it ends."""
    kept: list[Json] = []
    for each in events:
        if kept and each["kind"] in RUNS and kept[-1]["kind"] == each["kind"]:
            count = kept[-1].get("count", 1) + each.get("count", 1)  # a summary has its own
            kept[-1] = kept[-1] | {
                "count": count,
                "text": f"{count} in this run of events",
                "until_tick": each.get("tick"),
                "until_t_ns": each.get("t_ns"),
                "until_cursor": each["cursor"],
            }
        else:
            kept.append(each)
    return kept
