# SPDX-License-Identifier: Apache-2.0
"""Whether a request is what it may be; and answers as lines of JSON, in words of a client that has verbs only."""

from __future__ import annotations

import json
import math
from typing import Any

from ..control import plain
from ..errors import LitheError, NotRunning, Refused
from ..vocabulary import Schema, Verb, in_verbs, nearest

MOST_SHOWN = 100
TYPES: dict[str, tuple[type, ...]] = {
    "number": (int, float), "integer": (int,), "string": (str,), "boolean": (bool,), "array": (list,),
    "object": (dict,),
}  # fmt: skip
WORDS = {"boolean": "true or false", "string": "a text", "integer": "a whole number", "number": "a number",
         "array": "a list", "object": "an object"}  # fmt: skip
MOST_VALUE_SHOWN = 40


class Encoded(bytes):
    """A verb's result that is JSON already."""


class Verbatim(dict[str, Any]):
    """A verb's result whose words stay as they are."""


def as_json(value: Any) -> str:
    """One line; NaN and infinity become null. TypeError for values that JSON cannot represent."""
    try:
        return json.dumps(value, default=plain, allow_nan=False)
    except ValueError:
        return json.dumps(_with_nulls(value), default=lambda value: _with_nulls(plain(value)))


def encode(answer: dict[str, Any]) -> bytes:
    """The line of an answer; see as_json()."""
    result = answer.get("result")
    if isinstance(result, Encoded):
        head = as_json({key: value for key, value in answer.items() if key != "result"}).encode()
        return b"".join((head[:-1], b', "result": ', result, b"}\n"))
    return as_json(answer).encode() + b"\n"


def refusal(name: Any, refused: Refused) -> bytes:
    """The line that refuses the request with the id `name`."""
    body = {"code": refused.code, "message": refused.message, "next": refused.next, "detail": refused.detail}
    return encode({"id": name, "ok": False, "error": in_the_words_of_verbs(body)})


def refused_by(error: Exception) -> Refused:
    """What a client is told of an error while its request was handled."""
    if isinstance(error, Refused):
        return error
    if isinstance(error, NotRunning):
        return Refused("disconnected", str(error), "start the robot, then ask again")
    if isinstance(error, RecursionError | ValueError | TypeError | KeyError | ArithmeticError):
        what = {RecursionError: "nested too deeply", KeyError: f"missing: {error}"}.get(type(error), str(error))
        return Refused("bad_request", what, "the document verbs has verbs and arguments")
    return Refused("error", str(error) if isinstance(error, LitheError) else f"{type(error).__name__}: {error}")


def in_the_words_of_verbs(value: Any) -> Any:
    """The same with verbs in place of commands of the program `lithe`, in all of its texts."""
    if isinstance(value, str):
        return in_verbs(value)
    if isinstance(value, dict) and not isinstance(value, Verbatim):
        return {key: in_the_words_of_verbs(item) for key, item in value.items()}
    return [in_the_words_of_verbs(item) for item in value] if isinstance(value, list) else value


def _with_nulls(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _with_nulls(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_with_nulls(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def unprintable_in(value: Any, name: str = "") -> str | None:
    """The first key or text in a request that is not printable, written out harmlessly; None when all are.

    Printable is what str.isprintable() says: no control characters, line ends, escapes, nothing invisible or that turns
    the direction of writing. The supervisor asks the same of its own socket (spine/core/text.hpp). The `source` of a
    law is not asked: it has rules of its own.
    """
    if not name.isprintable():
        return repr(name[:MOST_SHOWN])
    if isinstance(value, str) and name != "source" and not value.isprintable():
        return repr(value[:MOST_SHOWN])
    if isinstance(value, dict):
        items = list(value.items())
    elif isinstance(value, list):
        items = [("", item) for item in value]
    else:
        return None
    return next((found for key, item in items if (found := unprintable_in(item, key)) is not None), None)


def check(verb: Verb, args: dict[str, Any]) -> None:
    """Raises Refused with every wrong name (`usage`), wrong type and missing argument (`bad_request`), not ranges."""
    unknown = [name for name in args if name not in verb.args]
    wrong = [f"'{verb.name}' has no argument '{name}'" for name in unknown]
    missing = [name for name in verb.required if name not in args]
    if missing:
        wrong.append(f"'{verb.name}' needs {' and '.join(repr(name) for name in missing)}")
    found = (_wrong(name, value, verb.args.get(name, {})) for name, value in args.items())
    wrong += [words for words in found if words]
    if not wrong:
        return
    next_step = f"describe with verb = {verb.name} has its arguments"
    if unknown:
        next_step = nearest(unknown[0], verb.args) if verb.args else "it takes none"
    raise Refused("usage" if unknown else "bad_request", "; ".join(wrong), next_step)


def _wrong(where: str, value: Any, schema: Schema) -> str | None:
    """A sentence for the first place in a value that is of another type than its schema says."""
    choices = [each for each in schema.get("anyOf", [schema]) if "type" in each]
    fits = [each for each in choices if _is(value, each["type"])]
    if choices and not fits:
        return f"{where} = {shown(value)} is not {' or '.join(WORDS[each['type']] for each in choices)}"
    parts: list[tuple[str, Any]] = []
    inner: Schema = {}
    if fits and isinstance(value, list):
        parts, inner = [(f"{where}[{i}]", each) for i, each in enumerate(value)], fits[0].get("items", {})
    elif fits and isinstance(value, dict):
        parts, inner = (
            [(f"{where}.{key}", each) for key, each in value.items()],
            fits[0].get("additionalProperties", {}),
        )
    return next((words for name, each in parts if (words := _wrong(name, each, inner))), None)


def _is(value: Any, kind: str) -> bool:
    if isinstance(value, bool):
        return kind == "boolean"
    return isinstance(value, TYPES[kind]) or (kind == "integer" and isinstance(value, float) and value.is_integer())


def shown(value: Any) -> str:
    """The beginning of a JSON value."""
    text = json.dumps(value)
    return text if len(text) <= MOST_VALUE_SHOWN else f"{text[:MOST_VALUE_SHOWN]}..."
