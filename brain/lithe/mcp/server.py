# SPDX-License-Identifier: Apache-2.0
"""Model Context Protocol: what each method does. Tools are the verbs of the gateway.

Threads: one reads; each request that asks the robot, or draws, has its own, so that a stop never waits for a swap.
"""

from __future__ import annotations

import json
import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .. import __version__
from ..control import plain
from ..errors import LitheError, NotRunning, Refused
from ..vocabulary import BY_NAME, VERBS, Effect, Tier, Verb, tier_of
from . import library, plots, protocol
from .permission import tier_in
from .protocol import Header, Json, Wrong

Send = Callable[[Json], None]  # takes one answer; from any thread
MOST_CALLS = 16  # at a time
MOST_STOPS = 16  # at a time, beside them; an e-stop is not counted
LOOK_S = 0.25  # at the permission, while a reference runs
STAY_S = 3600.0  # a reference that is to stay: as long as this server lives, and so long without a word
STAYS = (
    "stay is false here: over MCP a reference ends with the permission, with this server, and after {:g} s of silence"
)
MOST_ANSWER_BYTES = 64 << 10  # of one tool: a model reads it all
THINNER = (2, 4, 10, 20, 40, 100, 200, 400)  # a thinned history has every 20th tick
WHOLE = "the document swaps has every certificate in short; the whole file is on the robot's computer"
ROBOT = ("tools/call", "resources/list", "resources/read")  # methods that ask it
CAPABILITIES: Json = {"tools": {}, "resources": {}, "prompts": {}}
INFO = {"name": "lithe", "version": __version__}
INSTRUCTIONS = (
    "A robot whose control law you can try and replace while it moves. Begin with `describe` and `status`; read the "
    "resource lithe://contract before you write a law. `describe` with verb=NAME has that tool's arguments in full; "
    "every tool that changes something takes dry_run=true; brief=false gives a whole answer. A refusal says what to "
    "change. The answer of `swap` has the verdict of its probation, and old law beside new; `document` with name "
    "plots/laws.png shows all of them, plots/recent.png the last minute. `set_reference` moves the joints. [tier] is "
    "what a person must permit, for a time: tune (parameters), swap (laws), move (joints, modes), person. What reads, "
    "and hold, disarm, estop, stop_reference, need none."
)


def tool(verb: Verb) -> Json:
    """A verb, as tools/list tells it: in short, because a model reads all of it at the start."""
    words = re.split(r"[.;] ", verb.what)[0].rstrip(".")
    words += f" [{verb.tier.name}]" if verb.tier else ""
    schema: Json = {"type": "object"}
    if given := {name: _kind(each) for name, each in verb.args.items() if name != "dry_run"}:
        schema["properties"] = given
    if verb.required:
        schema["required"] = list(verb.required)
    # What is left out is: not read-only, destructive.
    gentle = {"destructiveHint": False}
    hints = {Effect.reads: {"readOnlyHint": True}, Effect.claims: gentle, Effect.stops: gentle}.get(verb.effect)
    return {"name": verb.name, "description": words, "inputSchema": schema} | ({"annotations": hints} if hints else {})


def _kind(schema: Json) -> Json:
    """Of an argument what it may be; `describe` with `verb` has the rest."""
    kept = {key: schema[key] for key in ("type", "enum") if key in schema}
    return kept | ({"items": {}} if kept.get("type") == "array" else {})


def said(text: str, error: bool = False) -> Json:
    """The result of a tool."""
    return {"content": [{"type": "text", "text": text}], "isError": error}


def too_long(text: str) -> str:
    """The error's words."""
    return f"the answer has {len(text)} bytes, of at most {MOST_ANSWER_BYTES}"


class Server:
    """`call(verb, args)` reaches the robot; verbs of a tier above observe need the file `permission`."""

    def __init__(self, call: Callable[[str, Json], Any], permission: Path) -> None:
        self._call = call
        self._permission = permission
        self._free = threading.BoundedSemaphore(MOST_CALLS)
        self._free_for_stops = threading.BoundedSemaphore(MOST_STOPS)
        self._since_ns = 0  # of the reference that was set here last
        self._running: set[threading.Thread] = set()
        self._methods: dict[str, Callable[[Json], Json]] = {
            "initialize": self._initialize,
            "server/discover": self._discover,
            "ping": lambda _: {},
            "tools/list": _one_page(lambda: {"tools": [tool(each) for each in VERBS]}),
            "tools/call": self._tool,
            "resources/list": _one_page(lambda: {"resources": library.resources(self._call)}),
            "resources/templates/list": _one_page(lambda: {"resourceTemplates": library.templates()}),
            "resources/read": self._read,
            "prompts/list": _one_page(lambda: {"prompts": library.prompts()}),
            "prompts/get": self._prompt,
        }

    def line(self, line: bytes, send: Send, header: Header | None = None) -> bool:
        """Handles one message. Whether an answer is due: it goes to `send`, perhaps later and from another thread."""
        name: str | int | None = None
        try:
            message = protocol.parsed(line)
            if "method" not in message or "id" not in message:
                return False  # an answer, though nothing was asked; a notification
            method, params = message["method"], message.get("params", {})
            if not isinstance(message["id"], str | int):
                raise Wrong(protocol.REQUEST, "id is a string or an integer")
            name = message["id"]
            if not isinstance(params, dict) or not isinstance(method, str):
                raise Wrong(protocol.REQUEST, "method is a string, params an object")
            stateless = protocol.is_stateless(method, params, header)
            if method not in self._methods:
                raise Wrong(protocol.METHOD, f"there is no method '{method}'")

            def work() -> Json:
                result = self._methods[method](params)
                return protocol.complete(method, result) if stateless else result

            self._start(method, params, name, work, send)
        except Wrong as error:
            send(protocol.answer(name, error=error.told()))
        return True

    def finish(self) -> None:
        """Waits for the requests that are still being handled. A reference ends with the connection to the gateway."""
        for thread in list(self._running):
            thread.join()
        self._since_ns = 0

    def _start(self, method: str, params: Json, name: str | int, work: Callable[[], Json], send: Send) -> None:
        """Answers; in a thread where the robot is asked, as far as there is a place. An e-stop always has one."""
        verb = BY_NAME.get(str(params.get("name"))) if method == "tools/call" else None
        stops = verb is not None and verb.effect is Effect.stops
        places = self._free_for_stops if stops else self._free
        if verb is not None and verb.name == "estop":
            places = threading.BoundedSemaphore(1)
        if method not in ROBOT:
            return self._answer(name, work, send)
        if not places.acquire(blocking=False):
            many = f"{MOST_STOPS} stops" if stops else f"{MOST_CALLS} requests"
            busy = f"busy: {many} are being handled\nnext: wait for one"
            return self._answer(name, lambda: said(busy, True) if verb else _fail(protocol.INTERNAL, busy), send)

        def run() -> None:
            try:
                self._answer(name, work, send)
            finally:
                places.release()
                self._running.discard(thread)

        thread = threading.Thread(target=run, name=f"lithe-mcp-{verb.name if verb else method}")
        self._running.add(thread)
        return thread.start()

    def _answer(self, name: str | int, work: Callable[[], Json], send: Send) -> None:
        try:
            result = work()
        except Wrong as error:
            return send(protocol.answer(name, error=error.told()))
        except Exception as error:  # a damaged file of the robot, say, must not leave a client without an answer
            words = str(error) if isinstance(error, LitheError) else f"{type(error).__name__}: {error}"
            return send(protocol.answer(name, error={"code": protocol.INTERNAL, "message": words}))
        return send(protocol.answer(name, result=result))

    def _initialize(self, params: Json) -> Json:
        asked = params.get("protocolVersion")
        return {
            "protocolVersion": asked if asked in protocol.HANDSHAKE else protocol.HANDSHAKE[0],
            "capabilities": CAPABILITIES,
            "serverInfo": INFO,
            "instructions": INSTRUCTIONS,
        }

    def _discover(self, _: Json) -> Json:
        return {
            "supportedVersions": protocol.VERSIONS,
            "capabilities": CAPABILITIES,
            "instructions": INSTRUCTIONS,
            "_meta": {protocol.META + "serverInfo": INFO},
        }

    # ---- tools
    def _tool(self, params: Json) -> Json:
        verb, args = BY_NAME.get(str(params.get("name"))), params.get("arguments") or {}
        if verb is None:
            raise Wrong(protocol.PARAMS, f"there is no tool '{params.get('name')}': see tools/list")
        if not isinstance(args, dict):
            raise Wrong(protocol.PARAMS, "arguments is an object")
        needed, given = tier_of(verb, args), tier_in(self._permission)
        if needed > given:
            return said(
                f"no_permission: '{verb.name}' needs tier {needed.name}; a person has permitted {given.name} by now\n"
                f"next: ask the person to run `python -m lithe.mcp allow --tier {needed.name} --minutes 15`",
                error=True,
            )
        if verb.name in ("swap", "shadow"):  # a model reads it all
            args = {"brief": True, **args}
        if verb.name == "swap":
            args = {"wait": True, **args}
        if verb.name == "set_params":
            args = {"wait": True, **args}
        asked_to_stay = verb.name == "set_reference" and args.get("stay") is True
        if asked_to_stay:  # not beyond this server: it watches the permission
            args = {"client_stale_s": STAY_S, **args, "stay": False}
        try:
            if verb.name == "document" and plots.is_one(args.get("name")):
                picture = plots.drawn(args["name"], self._call)
                return {"content": [{"type": "image", "data": picture, "mimeType": plots.TYPE}], "isError": False}
            result = self._fitting_history(args) if verb.name == "history" else self._call(verb.name, args)
            if isinstance(result, dict) and result.get("dry_run"):
                needed = tier_of(verb, {key: value for key, value in args.items() if key != "dry_run"})
                result |= {"needs_tier": needed.name} if needed > given else {}
            if verb.name == "set_reference" and "since_ns" in result:
                self._ends_with_the_permission(result)
                if asked_to_stay:
                    result = {**result, "note": STAYS.format(result["asked"]["client_stale_s"])}
            if verb.name == "describe" and isinstance(result, dict):  # tools/list has them
                result = {name: value for name, value in result.items() if name != "verbs"}
            text = protocol.encoded(result)
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
            next_step = (
                WHOLE if verb.name == "document" else "ask for fewer fields or joints, a shorter time, or every=N"
            )
            return said(f"too_long: {too_long(text)}\nnext: {next_step}", error=True)
        return said(text)

    def _fitting_history(self, args: Json) -> Any:
        """With more ticks left out, by a multiple of the `every` that was asked for, until it fits."""
        result, asked = self._call("history", args), max(1, int(args.get("every") or 1))
        whole_bytes = size = len(json.dumps(result, default=plain))
        for times in THINNER:
            if size <= MOST_ANSWER_BYTES:
                break
            if isinstance(result, dict) and whole_bytes <= times * MOST_ANSWER_BYTES:
                every = asked * times
                note = f"thinned to every={every}, so that it fits; fewer fields, joints or seconds leave more ticks"
                result = {**self._call("history", {**args, "every": every}), "every": every, "note": note}
                size = len(json.dumps(result, default=plain))
        return result

    def _ends_with_the_permission(self, told: Json) -> None:
        """The reference that was set, unless another has taken its place by then."""
        self._since_ns = since_ns = int(told["since_ns"])

        def watch() -> None:
            while self._since_ns == since_ns and tier_in(self._permission) >= Tier.move:
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
            found = library.read(uri, self._call)
        except NotRunning:
            raise
        except LitheError as error:
            raise Wrong(protocol.PARAMS, f"cannot read '{uri}': {error}; resources/list has all", uri=uri) from None
        text = found.get("text", "")
        if len(text) > MOST_ANSWER_BYTES:
            raise Wrong(protocol.PARAMS, f"cannot read '{uri}': {too_long(text)}; {WHOLE}", uri=uri)
        return {"contents": [{"uri": uri, **found}]}

    def _prompt(self, params: Json) -> Json:
        try:
            return library.prompt(str(params.get("name")), params.get("arguments") or {})
        except KeyError as error:
            raise Wrong(protocol.PARAMS, f"there is no prompt {error}; prompts/list has all") from None


def _fail(code: int, message: str) -> Json:
    raise Wrong(code, message)


def _one_page(make: Callable[[], Json]) -> Callable[[Json], Json]:
    """A list that is never cut into pages, so that no cursor is ours."""

    def page(params: Json) -> Json:
        if params.get("cursor") is not None:
            raise Wrong(protocol.PARAMS, "there is one page only: ask without cursor")
        return make()

    return page
