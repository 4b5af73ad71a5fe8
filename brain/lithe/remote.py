# SPDX-License-Identifier: Apache-2.0
"""Client of the gateway: needs only the standard library and a token.

Threads: may be shared. Errors: NotRunning, Refused.
"""

from __future__ import annotations

import json
import secrets
import socket
from pathlib import Path
from typing import Any

from .control import Client, LineSocket, refusal_in
from .errors import LitheError, NotRunning
from .files import read_regular


def _token(given: str | Path) -> str:
    """The token itself, or the first line of its file. An empty one is refused."""
    token, place = given, "the given token"
    if isinstance(given, Path):
        place = str(given)
        try:
            token = read_regular(given)
        except (OSError, ValueError) as error:
            raise LitheError(f"cannot read the token file {given} ({error})\n  next: python -m lithe.gateway") from None
    token = str(token).strip()
    if not token:
        raise LitheError(f"{place} is empty\n  next: take the token that `python -m lithe.gateway` wrote to its file")
    return token


class Remote:
    """A robot over TCP: `remote.call("swap", source=...)`, `remote.call("history", seconds=2.0, fields=[...])`.

    `token` is the token or, as a Path, the file the gateway wrote it to. `timeout_s` bounds connecting and each answer.
    After the gateway was restarted the next call connects again (with the same token: a Path is read again).
    All its connections are one client to the gateway: after one that broke, its lease is still its own for 10 s.
    """

    def __init__(self, host: str, port: int, token: str | Path, timeout_s: float = 60.0) -> None:
        client = secrets.token_hex(16)

        def say_hello(**more: bool) -> tuple[LineSocket, dict[str, Any]]:
            hello = json.dumps({"token": _token(token), "client": client, **more}).encode()
            try:
                sock = socket.create_connection((host, port), timeout_s)
            except OSError as error:
                raise NotRunning(f"no gateway at {host}:{port} ({error}): python -m lithe.gateway") from None
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            lines = LineSocket(sock)
            try:
                answer = lines.exchange(hello, "hello")
                if not answer.get("ok"):
                    raise refusal_in(answer)
            except LitheError:
                lines.close()
                raise
            return lines, answer

        self._say_hello = say_hello
        self._client = Client(lambda: say_hello()[0])

    def call(self, verb: str, /, **args: Any) -> Any:
        """Any verb of docs/reference/verbs.md; returns its result, raises Refused with its code."""
        return self.estop() if verb == "estop" else self._client.call(verb, args)

    def estop(self) -> Any:
        """At once: over its own connection, before all other requests, also when the gateway has no free place."""
        lines, answer = self._say_hello(estop=True)
        lines.close()
        return answer.get("result")

    def close(self) -> None:
        """Closes the connection; may be called twice."""
        self._client.close()

    def __enter__(self) -> Remote:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
