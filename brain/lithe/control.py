# SPDX-License-Identifier: Apache-2.0
"""The supervisor's control socket: one JSON document a line, both ways.

Threads: a Control may be shared, its calls are serialised. Errors: NotRunning, Refused.
"""

from __future__ import annotations

import json
import os
import socket
import threading
from pathlib import Path
from typing import Any

from .errors import LitheError, NotRunning, Refused


def run_dir() -> Path:
    """$LITHE_RUN_DIR, else /run/lithe (root), else $XDG_RUNTIME_DIR/lithe, else /tmp/lithe-<uid>."""
    if value := os.environ.get("LITHE_RUN_DIR"):
        return Path(value)
    if os.geteuid() == 0:
        return Path("/run/lithe")
    if value := os.environ.get("XDG_RUNTIME_DIR"):
        return Path(value) / "lithe"
    return Path(f"/tmp/lithe-{os.geteuid()}")


def find_robot() -> str:
    """The one robot that runs here; NotRunning if there is none, LitheError if there are several."""
    names = sorted(path.stem for path in run_dir().glob("*.sock"))
    if not names:
        raise NotRunning(f"no robot runs here (no socket in {run_dir()})\n  next: lithe run ROBOT.toml")
    if len(names) > 1:
        raise LitheError(f"several robots run here: {', '.join(names)}\n  next: lithe.connect('{names[0]}')")
    return names[0]


class LineSocket:
    """Requests and answers as JSON lines over a connected stream socket."""

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        self._file = sock.makefile("rwb")
        self._lock = threading.Lock()
        self._id = 0

    def call(self, verb: str, args: dict[str, Any]) -> Any:
        """Sends one request and returns its result."""
        with self._lock:
            self._id += 1
            request = {"id": self._id, "verb": verb, "args": args}
            try:
                self._file.write(json.dumps(request).encode() + b"\n")
                self._file.flush()
                line = self._file.readline()
            except OSError as error:
                raise NotRunning(f"the connection broke while asking '{verb}': {error}") from None
        if not line:
            raise NotRunning(f"the other side closed the connection while asking '{verb}'")
        try:
            answer = json.loads(line)
        except ValueError:
            answer = None
        if not isinstance(answer, dict):
            raise LitheError(f"the answer to '{verb}' is not a JSON object: is that a LITHE socket?")
        if answer.get("ok"):
            return answer.get("result")
        refusal = answer.get("error") or {}
        raise Refused(
            refusal.get("code", "error"),
            refusal.get("message", "refused"),
            refusal.get("next", ""),
            refusal.get("detail") or refusal,
        )

    def read_line(self) -> bytes:
        """One line as it comes; empty at the end."""
        return self._file.readline()

    def close(self) -> None:
        self._file.close()
        self._socket.close()


def connect_control(robot: str, timeout_s: float = 60.0) -> LineSocket:
    """Connects to the supervisor of `robot`."""
    path = run_dir() / f"{robot}.sock"
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    sock.settimeout(timeout_s)
    try:
        sock.connect(str(path))
    except OSError as error:
        sock.close()
        raise NotRunning(
            f"robot '{robot}' does not answer at {path} ({error.strerror})\n  next: lithe run ROBOT.toml"
        ) from None
    return LineSocket(sock)
