# SPDX-License-Identifier: Apache-2.0
"""One authenticated client of the gateway: handles its requests in order, and an e-stop before all others.

Two threads: one reads and answers an e-stop at once, whatever else is being done for this client; the other answers
all other requests one after the other. What a client may have pending and unread is bounded; one that does not read is
hung up on, and the gateway's log says so.
"""

from __future__ import annotations

import contextlib
import json
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from ..vocabulary import VERBS, Effect
from .turns import Turns

MOST_REQUEST_BYTES = 1 << 20
MOST_PENDING_BYTES = 256 << 10  # requests that wait for their turn; one longer than that waits alone
MOST_STOP_BYTES = 4096
SEND_BUFFER_BYTES = 256 << 10  # of the kernel
PIECE_BYTES = 64 << 10
UNREAD_S = 5  # how long one may leave an answer unread
# Whose computer or cable is gone has left after 40 s, not after two hours: its reference ends, its place is free.
KEEPALIVE = {socket.TCP_KEEPIDLE: 20, socket.TCP_KEEPINTVL: 5, socket.TCP_KEEPCNT: 4}
LEAST_BYTES_PER_S = 256 << 10  # and how fast it must read a long one

ESTOP = frozenset({"estop"})
STOPS = frozenset(each.name for each in VERBS if each.effect is Effect.stops)
Answer = Callable[[bytes], tuple[bytes, int]]


class TooSlow(Exception):
    """The client does not read its answers."""


def asks_for(line: bytes, verbs: frozenset[str]) -> bool:
    """Whether a request is short, and for one of these verbs."""
    if len(line) > MOST_STOP_BYTES or not any(verb.encode() in line for verb in verbs):
        return False
    try:
        request: Any = json.loads(line)
    except (ValueError, RecursionError):
        return False
    return isinstance(request, dict) and request.get("verb") in verbs


class Client:
    """Serves one connection until it ends. `answer(line)` gives the answer's line and how much of it is to be dropped
    from `turns` once it is sent; it never raises."""

    def __init__(
        self, link: socket.socket, rest: bytes, answer: Answer, turns: Turns, say: Callable[[str], None]
    ) -> None:
        link.setblocking(True)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in KEEPALIVE.items():
            link.setsockopt(socket.IPPROTO_TCP, option, value)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("ll", UNREAD_S, 0))
        self._link, self._heard, self._answer, self._turns, self._say = link, bytearray(rest), answer, turns, say
        self._sending = threading.Lock()
        self._changed = threading.Condition()
        self._pending: deque[bytes] = deque()
        self._pending_bytes = 0
        self._over = False  # nothing more will come
        self._gone = False  # nobody reads any more

    def serve(self) -> None:
        """Reads until the client has nothing more to say, and returns when all of it is answered."""
        worker = threading.Thread(target=self._work, name="lithe-gateway-client", daemon=True)
        worker.start()
        try:
            self._send(b'{"ok": true}\n')
            self._read()
        except (OSError, TooSlow) as error:
            self._hang_up(error)
        with self._changed:
            self._over = True
            self._changed.notify_all()
        worker.join()
        self._link.close()

    def stop_waits(self) -> bool:
        """Whether what stops the robot is among the requests that wait for the one being handled."""
        with self._changed:
            return any(asks_for(line, STOPS) for line in self._pending)

    def _read(self) -> None:
        """Line by line; a last one without its end counts. An oversized one is the last."""
        searched = 0
        while True:
            end = self._heard.find(b"\n", searched)
            if end >= 0 or len(self._heard) > MOST_REQUEST_BYTES:
                count = end + 1 if end >= 0 else len(self._heard)
                line = bytes(self._heard[:count])
                del self._heard[:count]
                searched = 0
                self._take(line)
                if len(line) > MOST_REQUEST_BYTES:
                    return  # the rest of an oversized line cannot be distinguished from a new request
                continue
            searched = len(self._heard)
            data = self._link.recv(PIECE_BYTES)
            if not data:
                if self._heard:
                    self._take(bytes(self._heard))
                return
            self._heard += data

    def _take(self, line: bytes) -> None:
        if asks_for(line, ESTOP):
            return self._send(self._answer(line)[0])
        with self._changed:
            self._changed.wait_for(
                lambda: self._gone or not self._pending or self._pending_bytes + len(line) <= MOST_PENDING_BYTES
            )
            if self._gone:
                raise OSError("the client has left")
            self._pending.append(line)
            self._pending_bytes += len(line)
            self._changed.notify_all()
        return None

    def _work(self) -> None:
        while (line := self._next()) is not None:
            answer, kept_bytes = self._answer(line)
            try:
                self._send(answer)
            except (OSError, TooSlow) as error:
                return self._hang_up(error)
            finally:
                if kept_bytes:
                    self._turns.drop(kept_bytes)
        return None

    def _next(self) -> bytes | None:
        with self._changed:
            self._changed.wait_for(lambda: self._gone or self._over or self._pending)
            if self._gone or not self._pending:
                return None
            line = self._pending.popleft()
            self._pending_bytes -= len(line)
            self._changed.notify_all()
            return line

    def _send(self, answer: bytes) -> None:
        """All of an answer. TooSlow when the client does not read it."""
        left, until_s = memoryview(answer), time.monotonic() + UNREAD_S + len(answer) / LEAST_BYTES_PER_S
        with self._sending:
            while left:
                try:
                    left = left[self._link.send(left[:PIECE_BYTES]) :]
                except BlockingIOError:
                    raise TooSlow(f"it left {len(left)} bytes of an answer unread for {UNREAD_S:g} s") from None
                if left and time.monotonic() > until_s:
                    raise TooSlow(f"it reads an answer slower than {LEAST_BYTES_PER_S >> 10} KiB a second")

    def _hang_up(self, why: Exception) -> None:
        if isinstance(why, TooSlow):
            with contextlib.suppress(OSError):
                host, port = self._link.getpeername()[:2]
                self._say(f"client {host}:{port} was disconnected: {why}")
        with self._changed:
            self._gone = True
            self._changed.notify_all()
        with contextlib.suppress(OSError):
            self._link.shutdown(socket.SHUT_RDWR)
