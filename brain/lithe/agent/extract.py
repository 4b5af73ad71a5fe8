# SPDX-License-Identifier: Apache-2.0
"""Finds the law in what a language model answered. Pure functions."""

from __future__ import annotations

import html
import json
import re
from typing import Any

from ..errors import LitheError
from .model import Reply

MOST_SOURCE_BYTES = 64 << 10
ENTRY = "LITHE_LAW("
KEYS = ("source", "code", "law")  # of an object that holds a law; `arguments` may lie around it
FENCE = re.compile(r"^[ \t]*```[ \t]*([A-Za-z0-9+_-]*)[^\n]*\n(.*?)(?:```|\Z)", re.S | re.M)
WHOLE = re.compile(r"#include\b.*LITHE_LAW\([^\n]*", re.S)  # a law with prose around it
CPP = {"cpp", "c++", "cc", "cxx", "c", "hpp"}
THOUGHTS = re.compile(r"<think>.*?</think>", re.S)


class NoLaw(LitheError):
    """The answer holds no law that could be tried; `kind` is one word for programs."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(f"{message}\n  next: answer with one whole law in one ```cpp block")
        self.kind, self.message = kind, message


def _in_object(value: Any, depth: int = 0) -> list[str]:
    """The laws in an object of JSON: under one of KEYS, or inside `arguments`, which may be text once more."""
    if isinstance(value, str) and depth:
        value = _as_json(value)
    if not isinstance(value, dict) or depth > 3:
        return []
    found = [value[key] for key in KEYS if isinstance(value.get(key), str)]
    for key in ("arguments", "parameters", "function"):
        found += _in_object(value.get(key), depth + 1)
    return found


def _as_json(text: str) -> Any:
    try:
        return json.loads(text, strict=False)  # models write line ends into strings
    except (ValueError, RecursionError):
        return None


def candidates(reply: Reply) -> tuple[str, list[str]]:
    """Where the law was found, and what stands there. The first place with anything in it counts."""
    tools = [law for one in reply.arguments for law in _in_object(_as_json(one) if isinstance(one, str) else one)]
    if tools:
        return "tool call", tools
    text = THOUGHTS.sub("", reply.text).strip()
    fences = [(word.lower(), body) for word, body in FENCE.findall(text)]
    calls = re.findall(r"<tool_call>\s*(.*?)\s*</tool_call>", text, re.S)
    objects = [_as_json(one) for one in (text, *calls, *(body for word, body in fences if word in ("json", "")))]
    if inside := [law for one in objects for law in _in_object(one)]:
        return "JSON in the text", inside
    if cpp := [body for word, body in fences if word in CPP]:
        return "cpp block", cpp
    if fences:
        return "block", [body for _, body in fences]
    return "whole text", [each[0] for each in [WHOLE.search(text)] if each]


def law_in(reply: Reply) -> tuple[str, list[str]]:
    """The law's source, and what had to be mended or left out to get it. NoLaw: there is none, or more than one."""
    place, found = candidates(reply)
    if not found:
        raise NoLaw("no_code", "the answer holds no code")
    told = [] if place == "cpp block" and len(found) == 1 else [f"taken from: {place}"]
    cleaned = []
    for one in found:
        source = one.strip() + "\n"
        if inner := FENCE.search(source):
            source = inner[2]
            told.append("a fence inside was left out")
        if "&lt;" in source and "#include <" not in source:
            source = html.unescape(source)
            told.append("HTML escapes were replaced")
        cleaned.append(source)
    whole = list(dict.fromkeys(one for one in cleaned if ENTRY in one))
    if len(whole) > 1 or any(one.count(ENTRY) > 1 for one in whole):
        raise NoLaw("several", f"the answer holds {max(len(whole), 2)} laws; which one is meant?")
    if not whole:
        raise NoLaw("no_entry", f'the code does not end with {ENTRY}Type, "name"), so it is no whole law')
    size = len(whole[0].encode("utf-8", "replace"))
    if size > MOST_SOURCE_BYTES:
        raise NoLaw("too_long", f"the law has {size} bytes, at most {MOST_SOURCE_BYTES} are read")
    if len(cleaned) > 1:
        told.append(f"{len(cleaned) - 1} other blocks without an entry were left out")
    return whole[0], told
