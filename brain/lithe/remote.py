# SPDX-License-Identifier: Apache-2.0
"""The other end of the gateway: needs nothing but the standard library and a token.

Threads: may be shared. Errors: NotRunning, Refused.
"""

from __future__ import annotations

import json
import socket
from typing import Any

from .control import LineSocket
from .errors import NotRunning, Refused


class Remote:
    """A robot across TCP: `remote.call("swap", source=...)`, `remote.call("history", seconds=2.0, fields=[...])`."""

    def __init__(self, host: str, port: int, token: str, timeout_s: float = 60.0) -> None:
        try:
            sock = socket.create_connection((host, port), timeout_s)
        except OSError as error:
            raise NotRunning(f"no gateway at {host}:{port} ({error}): python -m lithe.gateway") from None
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.sendall(json.dumps({"token": token}).encode() + b"\n")
        self._lines = LineSocket(sock)
        if b"true" not in self._lines.read_line():
            self.close()
            raise Refused("token", "the gateway does not accept this token", "read it from the token file")

    def call(self, verb: str, /, **args: Any) -> Any:
        return self._lines.call(verb, args)

    def close(self) -> None:
        self._lines.close()
