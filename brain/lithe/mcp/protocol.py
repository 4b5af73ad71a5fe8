# SPDX-License-Identifier: Apache-2.0
"""JSON-RPC 2.0, and the versions of MCP: with a handshake, and since 2026-07-28 without one.

Without a handshake each request names its version in params._meta; over HTTP headers repeat version, method and name.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable
from typing import Any

from ..control import plain

Json = dict[str, Any]
MOST_LINE_BYTES = 1 << 20
STATELESS = "2026-07-28"
HANDSHAKE = ("2025-11-25", "2025-06-18", "2025-03-26", "2024-11-05")  # the newest first
VERSIONS = (STATELESS, *HANDSHAKE)
META = "io.modelcontextprotocol/"
PARSE, REQUEST, METHOD, PARAMS, INTERNAL = -32700, -32600, -32601, -32602, -32603
HEADER, VERSION = -32020, -32022
HTTP_STATUS = {METHOD: 404, INTERNAL: 200}  # of an error without a handshake; 400 for all others
NAMED = {"tools/call": "name", "prompts/get": "name", "resources/read": "uri"}  # what the header Mcp-Name repeats
WITH_HANDSHAKE, WITHOUT = ("initialize", "ping"), ("server/discover",)
CACHEABLE = (*WITHOUT, "tools/list", "prompts/list", "resources/list", "resources/templates/list", "resources/read")
Header = Callable[[str], str | None]  # the value of a header; None: there is none, as on stdin


class Wrong(Exception):
    """An error of the protocol: code, sentence, and data for programs."""

    def __init__(self, code: int, message: str, **data: Any) -> None:
        super().__init__(message)
        self.code, self.data = code, data

    def told(self) -> Json:
        """As the answer has it."""
        return {"code": self.code, "message": str(self)} | ({"data": self.data} if self.data else {})


def parsed(line: bytes) -> Json:
    """The message. Wrong: it is none."""
    if len(line) > MOST_LINE_BYTES:
        raise Wrong(REQUEST, f"a message has at most {MOST_LINE_BYTES} bytes")
    try:
        message = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise Wrong(PARSE, f"not one line of JSON: {error}") from None
    if not isinstance(message, dict) or message.get("jsonrpc") != "2.0":
        raise Wrong(REQUEST, 'a message is one object with "jsonrpc": "2.0"')
    return message


def encoded(value: Any) -> str:
    """JSON in as few bytes as possible: a model reads it all."""
    return json.dumps(value, default=plain, separators=(",", ":"))


def answer(name: str | int | None, **what: Json) -> Json:
    """The result or the error of the request with this id; None: it was not readable."""
    return {"jsonrpc": "2.0", **({} if name is None else {"id": name}), **what}


def is_stateless(method: str, params: Json, header: Header | None) -> bool:
    """Whether a request comes without a handshake. Wrong: it lacks a field, its headers differ, or its version is none
    of ours."""
    given = params.get("_meta")
    meta = given if isinstance(given, dict) else {}
    said = header("MCP-Protocol-Version") if header is not None else None
    version = meta.get(META + "protocolVersion")
    if version is None and method not in WITHOUT and said != STATELESS:
        if said is not None and said not in HANDSHAKE:
            raise _unsupported(said)
        return False
    if missing := [key for key in ("protocolVersion", "clientCapabilities") if META + key not in meta]:
        raise Wrong(PARAMS, f"params._meta lacks {', '.join(META + key for key in missing)}")
    if header is not None:
        subject = params.get(NAMED.get(method, ""))
        repeated = {"MCP-Protocol-Version": version, "Mcp-Method": method, "Mcp-Name": subject}
        for name, value in repeated.items():
            if value is not None and _decoded(header(name) or "") != value:
                raise Wrong(HEADER, f"the header {name} is {header(name)!r}, the message has {value!r}")
    if version != STATELESS:
        raise _unsupported(version)
    if method in WITH_HANDSHAKE:
        raise Wrong(METHOD, f"there is no method '{method}' in version {STATELESS}")
    return True


def complete(method: str, result: Json) -> Json:
    """A result as a client without a handshake expects it. Nothing is to be kept: the robot may have changed."""
    return {**result, "resultType": "complete"} | ({"ttlMs": 0, "cacheScope": "private"} if method in CACHEABLE else {})


def http_status(told: Json, header: Header) -> int:
    """Of an answer. With a handshake an error is an answer like any other."""
    code = told.get("error", {}).get("code")
    handshake = header("MCP-Protocol-Version") in (None, *HANDSHAKE) and code not in (HEADER, VERSION)
    return 200 if code is None or handshake else HTTP_STATUS.get(code, 400)


def _unsupported(version: Any) -> Wrong:
    return Wrong(VERSION, f"version {version!r}: one of {', '.join(VERSIONS)}", supported=VERSIONS, requested=version)


def _decoded(header: str) -> str | None:
    """A header's value; what does not fit into one comes as =?base64?...?=. None: it is damaged."""
    header = header.strip()
    if not (header.startswith("=?base64?") and header.endswith("?=")):
        return header
    try:
        return base64.b64decode(header[9:-2], validate=True).decode()
    except ValueError:
        return None
