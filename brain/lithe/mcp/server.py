# SPDX-License-Identifier: Apache-2.0
"""Model Context Protocol: JSON-RPC 2.0, one message per line. Tools are the verbs of the gateway.

Threads: one reads; each call of a tool has its own, so that a stop never waits for a swap.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .. import __version__
from ..control import plain
from ..errors import LitheError, NotRunning, Refused
from ..vocabulary import BY_NAME, VERBS, Effect, Verb
from . import library
from .permission import remaining_s

Json = dict[str, Any]
VERSIONS = ("2025-06-18", "2025-03-26", "2024-11-05")  # the newest first
Send = Callable[[Json], None]  # takes one answer; from any thread
MOST_LINE_BYTES = 1 << 20
MOST_CALLS = 16  # at a time
MOST_STOPS = 16  # at a time, beside them; an e-stop is not counted
LOOK_S = 0.25  # at the permission, while a reference runs
STAY_S = 3600.0  # a reference that is to stay: as long as this server lives, and so long without a word
MOST_ANSWER_BYTES = 64 << 10  # of one tool: a model reads it all
WHOLE = "the document swaps has every certificate in short; the whole file is on the robot's computer"
PARSE, REQUEST, METHOD, PARAMS = -32700, -32600, -32601, -32602
INSTRUCTIONS = (
    "A robot whose control law you can try and replace while it moves. Begin with `describe` and `status`; read the "
    "resource lithe://contract before you write a law. `law_check` costs nothing. A refusal says what to change. The "
    "answer of `swap` has the verdict of its probation, and old law beside new. `set_reference` moves the joints. "
    "Tools that can move the robot need a person's permission; hold, disarm, estop, rollback, revert_params never do."
)


class Wrong(Exception):
    """An error of the protocol: code and sentence."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


def tool(verb: Verb) -> Json:
    """A verb, as tools/list tells it."""
    words = verb.what + (" Needs a person's permission." if verb.effect is Effect.moves else "")
    hints = {"readOnlyHint": verb.effect is Effect.reads, "destructiveHint": verb.effect is Effect.moves}
    return {"name": verb.name, "description": words, "inputSchema": verb.schema(), "annotations": hints}


def said(text: str, error: bool = False) -> Json:
    """The result of a tool."""
    return {"content": [{"type": "text", "text": text}], "isError": error}


def too_long(text: str) -> str:
    """The error's words."""
    return f"the answer has {len(text)} bytes, of at most {MOST_ANSWER_BYTES}"


def answer(send: Send, name: Any, **what: Json) -> None:
    """The result or the error of the request with this id."""
    send({"jsonrpc": "2.0", "id": name, **what})


class Server:
    """`call(verb, args)` reaches the robot; moving verbs need the file `permission`."""

    def __init__(self, call: Callable[[str, Json], Any], permission: Path) -> None:
        self._call = call
        self._permission = permission
        self._free = threading.BoundedSemaphore(MOST_CALLS)
        self._free_for_stops = threading.BoundedSemaphore(MOST_STOPS)
        self._since_ns = 0  # of the reference that was set here last
        self._running: set[threading.Thread] = set()
        self._methods: dict[str, Callable[[Json], Json]] = {
            "initialize": self._initialize,
            "ping": lambda _: {},
            "tools/list": lambda _: {"tools": [tool(each) for each in VERBS]},
            "resources/list": lambda _: {"resources": library.resources(self._call)},
            "resources/templates/list": lambda _: {"resourceTemplates": []},
            "resources/read": self._read,
            "prompts/list": lambda _: {"prompts": library.prompts()},
            "prompts/get": self._prompt,
        }

    def line(self, line: bytes, send: Send) -> bool:
        """Handles one message. Whether an answer is due: it goes to `send`, perhaps later and from another thread."""
        name: Any = None
        try:
            if len(line) > MOST_LINE_BYTES:
                raise Wrong(REQUEST, f"a message has at most {MOST_LINE_BYTES} bytes")
            try:
                message = json.loads(line)
            except (ValueError, RecursionError) as error:
                raise Wrong(PARSE, f"not one line of JSON: {error}") from None
            if not isinstance(message, dict) or message.get("jsonrpc") != "2.0":
                raise Wrong(REQUEST, 'a message is one object with "jsonrpc": "2.0"')
            if "method" not in message:
                return False  # an answer; nothing was asked
            name, method, params = message.get("id"), message["method"], message.get("params", {})
            if "id" not in message:
                return False  # a notification
            if not isinstance(params, dict) or not isinstance(method, str) or not isinstance(name, str | int):
                raise Wrong(REQUEST, "id is a string or an integer, method a string, params an object")
            if method == "tools/call":
                self._start_tool(name, params, send)
                return True
            if method not in self._methods:
                raise Wrong(METHOD, f"there is no method '{method}'")
            answer(send, name, result=self._methods[method](params))
        except Wrong as error:
            answer(send, name, error={"code": error.code, "message": str(error)})
        return True

    def finish(self) -> None:
        """Waits for the calls that still run. A reference ends with the connection to the gateway."""
        for thread in list(self._running):
            thread.join()
        self._since_ns = 0

    def _initialize(self, params: Json) -> Json:
        asked = params.get("protocolVersion")
        return {
            "protocolVersion": asked if asked in VERSIONS else VERSIONS[0],
            "capabilities": {"tools": {}, "resources": {}, "prompts": {}},
            "serverInfo": {"name": "lithe", "version": __version__},
            "instructions": INSTRUCTIONS,
        }

    # ---- tools
    def _start_tool(self, name: str | int, params: Json, send: Send) -> None:
        verb, args = BY_NAME.get(str(params.get("name"))), params.get("arguments") or {}
        if verb is None:
            raise Wrong(PARAMS, f"there is no tool '{params.get('name')}': see tools/list")
        if not isinstance(args, dict):
            raise Wrong(PARAMS, "arguments is an object")
        places = self._free_for_stops if verb.effect is Effect.stops else self._free
        if verb.name == "estop":  # always has a place
            places = threading.BoundedSemaphore(1)
        if not places.acquire(blocking=False):
            many = f"{MOST_STOPS} stops" if verb.effect is Effect.stops else f"{MOST_CALLS} calls"
            answer(send, name, result=said(f"busy: {many} run already\nnext: wait for one", True))
            return
        thread = threading.Thread(
            target=self._run_tool, args=(name, verb, args, places, send), name=f"lithe-mcp-{verb.name}"
        )
        self._running.add(thread)
        thread.start()

    def _run_tool(
        self, name: str | int, verb: Verb, args: Json, places: threading.BoundedSemaphore, send: Send
    ) -> None:
        try:
            answer(send, name, result=self._tool(verb, args))
        finally:
            places.release()
            self._running.discard(threading.current_thread())

    def _tool(self, verb: Verb, args: Json) -> Json:
        if verb.effect is Effect.moves and not remaining_s(self._permission):
            return said(
                f"no_permission: '{verb.name}' can move the robot, and no person has permitted that, or time is over\n"
                "next: ask the person to run `python -m lithe.mcp allow --minutes 15`",
                error=True,
            )
        if verb.name == "swap":
            args = {"brief": True, "wait": True, **args}  # a model reads it all
        if verb.name == "set_params":
            args = {"wait": True, **args}
        if verb.name == "set_reference" and args.get("stay"):  # not beyond this server: it watches the permission
            args = {**args, "stay": False, "client_stale_s": STAY_S}
        try:
            result = self._call(verb.name, args)
            if verb.name == "set_reference" and "since_ns" in result:
                self._ends_with_the_permission(result)
            text = json.dumps(result, default=plain)
        except Refused as error:
            detail = json.dumps(error.detail, default=plain) if error.detail else ""
            return said(
                f"{error.code}: {error.message}\nnext: {error.next}\n{detail[:MOST_ANSWER_BYTES]}".rstrip(), True
            )
        except NotRunning as error:
            return said(f"not_running: {error}", error=True)
        except LitheError as error:
            return said(f"error: {error}", error=True)
        if len(text) > MOST_ANSWER_BYTES:
            next_step = WHOLE if verb.name == "document" else "ask for fewer fields, a shorter time, or every=N"
            return said(f"too_long: {too_long(text)}\nnext: {next_step}", error=True)
        return said(text)

    def _ends_with_the_permission(self, told: Json) -> None:
        """The reference that was set, unless another has taken its place by then."""
        self._since_ns = since_ns = int(told["since_ns"])

        def watch() -> None:
            while self._since_ns == since_ns and remaining_s(self._permission):
                time.sleep(LOOK_S)
            while self._since_ns == since_ns:
                try:
                    if self._call("reference", {})["since_ns"] == since_ns:
                        self._call("stop_reference", {})
                    return
                except LitheError:  # a connection that broke; a gateway that has gone streams nothing
                    time.sleep(LOOK_S)

        threading.Thread(target=watch, name="lithe-mcp-permission", daemon=True).start()

    # ---- resources and prompts
    def _read(self, params: Json) -> Json:
        uri = str(params.get("uri"))
        try:
            mime, text = library.read(uri, self._call)
        except (KeyError, OSError, LitheError) as error:
            raise Wrong(PARAMS, f"cannot read '{uri}': {error}; resources/list has all") from None
        if len(text) > MOST_ANSWER_BYTES:
            raise Wrong(PARAMS, f"cannot read '{uri}': {too_long(text)}; {WHOLE}")
        return {"contents": [{"uri": uri, "mimeType": mime, "text": text}]}

    def _prompt(self, params: Json) -> Json:
        try:
            return library.prompt(str(params.get("name")), params.get("arguments") or {})
        except KeyError as error:
            raise Wrong(PARAMS, f"there is no prompt {error}; prompts/list has all") from None
