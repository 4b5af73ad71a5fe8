# SPDX-License-Identifier: Apache-2.0
"""Reads schema/wire.toml into a model in which every offset is known, or says what is wrong on which line."""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

TYPES = {"uint8": 1, "char": 1, "uint32": 4, "int32": 4, "uint64": 8, "int64": 8, "float64": 8}
UNITS = {
    "rad": "_rad",
    "rad/s": "_rad_s",
    "rad/s^2": "_rad_s2",
    "N m": "_nm",
    "N m/s": "_nm_s",
    "N m/rad": "_nm_rad",
    "N m s/rad": "_nm_s_rad",
    "ns": "_ns",
    "us": "_us",
    "s": "_s",
    "Hz": "_hz",
    "V": "_v",
    "A": "_a",
    "W": "_w",
    "m": "_m",
    "kg": "_kg",
    "degC": "_degc",
}
LINE = 128  # items start on pairs of cache lines: adjacent-line prefetch couples two
RECORD_ALIGN = 64
FIELD = re.compile(
    r"^(?P<type>\w+)(?:\[(?P<count>[\w*]+)\])?\s+(?P<name>\w+)\s*(?:#\s*(?:\[(?P<unit>[^\]]+)\])?\s*(?P<text>.*))?$"
)
ITEM = re.compile(
    r"^(?P<kind>\w+)(?:\s+(?P<message>[A-Z]\w*))?\s+(?P<name>[a-z]\w*)(?:\[(?P<times>\w+)\])?(?:\s+(?P<depth>\d+))?$"
)
ITEM_KINDS = ("channel", "ring", "mailbox", "ack", "word", "plain")


class SchemaError(Exception):
    """What is wrong with the schema, with file, line and what to do."""


@dataclass
class Field:
    type: str
    name: str
    count: int  # elements; 1 for a scalar
    dims: str  # as written, e.g. "NW*NJ"; empty for a scalar
    unit: str
    text: str
    offset: int = 0

    @property
    def size(self) -> int:
        return TYPES[self.type] * self.count


@dataclass
class Message:
    name: str
    text: str
    fields: list[Field]
    size: int = 0


@dataclass
class Item:
    kind: str
    message: str
    name: str
    depth: int
    times: int
    offset: int = 0
    stride: int = 0  # of one of `times` equal items


@dataclass
class Segment:
    name: str
    writer: str
    items: list[Item] = field(default_factory=list)
    size: int = 0  # without the schema text at the end


@dataclass
class Schema:
    abi_major: int
    consts: dict[str, int]
    enums: dict[str, dict[str, int]]
    flags: dict[str, dict[str, int]]
    messages: dict[str, Message]
    segments: dict[str, Segment]

    def canonical(self) -> str:
        """One line per field and item, in order: what the layout hash covers and every segment carries."""
        lines = [f"abi:{self.abi_major}"]
        for message in self.messages.values():
            for f in message.fields:
                lines.append(f"{message.name}.{f.name}:{f.type}[{f.count}]:{f.offset}:{f.size}:{f.unit or '-'}")
        for segment in self.segments.values():
            for i in segment.items:
                lines.append(f"{segment.name}/{i.name}:{i.kind}:{i.message or '-'}:{i.depth}x{i.times}:{i.offset}")
        return "\n".join(lines) + "\n"

    def layout_hash(self) -> int:
        return int.from_bytes(hashlib.sha256(self.canonical().encode()).digest()[:8], "little")


def align(value: int, to: int) -> int:
    return (value + to - 1) // to * to


def item_bytes(kind: str, message_size: int, depth: int) -> int:
    """Bytes of one item; spine/ipc asserts that its templates agree."""
    if kind == "channel":
        return LINE + 4 * align(8 + message_size, LINE)
    if kind in ("ring", "mailbox"):
        return LINE + depth * align(8 + message_size, RECORD_ALIGN)
    if kind == "ack":
        return LINE + 8 * depth
    if kind == "word":
        return 8
    return message_size


class Reader:
    """Turns the text into a Schema. Every error names the line."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.text = path.read_text(encoding="utf-8")
        try:
            self.data = tomllib.loads(self.text)
        except tomllib.TOMLDecodeError as error:
            raise SchemaError(f"{path}: not valid TOML: {error}") from None
        self.consts: dict[str, int] = self.data.get("const", {})
        self.start = 0  # index of the line being read

    def fail(self, needle: str, what: str, fix: str) -> SchemaError:
        lines = self.text.splitlines()
        after = self.start
        if not (after < len(lines) and needle in lines[after]):
            after = 0
        line = next((n for n, text in enumerate(lines[after:], after + 1) if needle in text), 0)
        return SchemaError(f"{self.path}:{line}: {what}\n  in: {needle.strip()}\n  fix: {fix}")

    def body(self, table: str, key: str, text: str) -> Iterator[str]:
        """The lines of a table's text, with `start` on each: the same line may stand in several tables."""
        lines = self.text.splitlines()
        opening = f'{key} = """'
        head = next((n for n, line in enumerate(lines) if line.strip() == f"[{table}]"), 0)
        first = next((n + 1 for n, line in enumerate(lines) if n > head and line.strip() == opening), 0)
        for number, line in enumerate(text.splitlines()):
            self.start = first + number
            if line.strip():
                yield line
        self.start = head

    def read(self) -> Schema:
        known = {"abi_major", "const", "enum", "flags", "message", "segment"}
        for key in self.data:
            if key not in known:
                raise self.fail(key, f"unknown section '{key}'", f"use one of {', '.join(sorted(known))}")
        messages = {name: self.message(name, body) for name, body in self.data.get("message", {}).items()}
        schema = Schema(
            self.data.get("abi_major", 1),
            self.consts,
            self.data.get("enum", {}),
            self.data.get("flags", {}),
            messages,
            {},
        )
        for name, values in {**schema.enums, **schema.flags}.items():
            if len(set(values.values())) != len(values):
                raise self.fail(name, f"two names of {name} have the same value", "give each its own value")
        if "SegmentHeader" not in messages:
            raise SchemaError(f"{self.path}: message SegmentHeader is missing\n  fix: every segment starts with it")
        header = align(messages["SegmentHeader"].size, LINE)
        for name, body in self.data.get("segment", {}).items():
            schema.segments[name] = self.segment(name, body, messages, header)
        return schema

    def message(self, name: str, body: dict[str, str]) -> Message:
        message = Message(name, body.get("text", ""), [])
        offset = 0
        for line in self.body(f"message.{name}", "fields", body.get("fields", "")):
            f = self.field(name, line)
            if any(f.name == other.name for other in message.fields):
                raise self.fail(line, f"{name}.{f.name} is there twice", "rename one of them")
            gap = -offset % TYPES[f.type]
            if gap:
                raise self.fail(
                    line,
                    f"{name}.{f.name} would need {gap} hidden bytes of padding before it (offset {offset})",
                    f"put `uint8[{gap}] pad{offset}` on the line before it",
                )
            f.offset = offset
            offset += f.size
            message.fields.append(f)
        if not message.fields:
            raise self.fail(f"message.{name}", f"message {name} has no fields", "give it some, or remove it")
        if offset % 8:
            raise self.fail(
                f"message.{name}",
                f"message {name} is {offset} bytes, not a multiple of 8",
                f"put `uint8[{-offset % 8}] pad{offset}` at its end",
            )
        message.size = offset
        return message

    def field(self, message: str, line: str) -> Field:
        match = FIELD.match(line.strip())
        if not match:
            raise self.fail(line, f"not a field of {message}", "write `type name  # [unit] text`")
        kind, name, dims = match["type"], match["name"], match["count"] or ""
        if kind not in TYPES:
            raise self.fail(line, f"unknown type '{kind}'", f"use one of {', '.join(TYPES)}")
        unit = match["unit"] or ""
        self.check_unit(line, kind, name, unit)
        return Field(kind, name, self.count(line, dims), dims, unit, (match["text"] or "").strip())

    def check_unit(self, line: str, kind: str, name: str, unit: str) -> None:
        suffixes = [s for s in UNITS.values() if name.endswith(s)]
        longest = max(suffixes, key=len, default="")
        if unit and unit != "1":
            if unit not in UNITS:
                raise self.fail(line, f"unknown unit [{unit}]", f"use one of {', '.join(UNITS)}, or [1]")
            if longest != UNITS[unit]:
                raise self.fail(
                    line, f"'{name}' is in [{unit}] but does not end in '{UNITS[unit]}'", "name it so, or mend the unit"
                )
        elif longest:
            unit_of = next(u for u, s in UNITS.items() if s == longest)
            raise self.fail(
                line, f"'{name}' ends in '{longest}' but says no unit", f"write `# [{unit_of}] ...`, or rename it"
            )
        elif kind == "float64" and not unit:
            raise self.fail(
                line, f"'{name}' is a float64 without a unit", "write `# [unit] ...`, [1] for a pure number"
            )

    def count(self, line: str, dims: str) -> int:
        product = 1
        for factor in dims.split("*") if dims else []:
            if factor.isdigit():
                product *= int(factor)
            elif factor in self.consts:
                product *= self.consts[factor]
            else:
                raise self.fail(line, f"unknown size '{factor}'", f"use a number or one of {', '.join(self.consts)}")
        if product < 1:
            raise self.fail(line, "an array of no elements", "give it at least one")
        return product

    def segment(self, name: str, body: dict[str, str], messages: dict[str, Message], header: int) -> Segment:
        segment = Segment(name, body.get("writer", ""))
        if not segment.writer:
            raise self.fail(
                f"segment.{name}", f"segment {name} has no writer", 'say `writer = "..."`: exactly one process'
            )
        offset = header
        for line in self.body(f"segment.{name}", "items", body.get("items", "")):
            match = ITEM.match(line.strip())
            if not match or match["kind"] not in ITEM_KINDS:
                raise self.fail(
                    line,
                    f"not an item of segment {name}",
                    f"write `kind Message name [depth]`, kind one of {', '.join(ITEM_KINDS)}",
                )
            kind, message = match["kind"], match["message"] or ""
            if kind != "word" and message not in messages:
                raise self.fail(line, f"unknown message '{message}'", f"use one of {', '.join(messages)}")
            depth = int(match["depth"] or 0)
            if any(match["name"] == other.name for other in segment.items):
                raise self.fail(line, f"{name}/{match['name']} is there twice", "rename one of them")
            if kind in ("ring", "mailbox", "ack") and (depth < 2 or depth & (depth - 1)):
                raise self.fail(
                    line, f"depth {depth} is not a power of two", f"write e.g. `{line.strip().rsplit(' ', 1)[0]} 16`"
                )
            item = Item(kind, message, match["name"], depth, self.count(line, match["times"] or ""))
            item.offset = offset
            item.stride = align(item_bytes(kind, messages[message].size if message else 8, depth), LINE)
            offset += item.stride * item.times
            segment.items.append(item)
        segment.size = offset
        return segment


def load(path: Path) -> Schema:
    return Reader(path).read()
