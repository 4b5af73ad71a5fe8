# SPDX-License-Identifier: Apache-2.0
"""A bad connection to a server on this computer, for tests: slow both ways, and cut where a test wants it.

It carries lines: requests one way, answers the other. What it cuts is gone; nothing is ever sent twice by it.
"""

from __future__ import annotations

import contextlib
import json
import queue
import random
import socket
import threading
import time
from types import TracebackType
from typing import Any

CUTS = ("request", "waiting", "answer", "ghost", "for_good")
PIECE_BYTES = 1 << 16


class Way:
    """One direction of one connection: what is put in comes out at the other end later, in its order."""

    def __init__(self, out: socket.socket, link: SlowLink) -> None:
        self._out, self._link = out, link
        self._things: queue.Queue[tuple[float, bytes] | None] = queue.Queue()
        self._free_s = 0.0
        threading.Thread(target=self._run, daemon=True).start()

    def put(self, data: bytes, delay_s: float) -> None:
        """Comes out after that time, and not before what was put in earlier."""
        self._free_s = max(self._free_s, time.monotonic() + delay_s)
        self._things.put((self._free_s, data))

    def end(self) -> None:
        """Nothing more is put in; returns when all of it has come out."""
        self._things.put(None)
        self._things.join()

    def _run(self) -> None:
        while (thing := self._things.get()) is not None:
            due_s, data = thing
            while (left_s := due_s - time.monotonic()) > 0:
                time.sleep(left_s)
            with contextlib.suppress(OSError):
                if not self._link.silent:
                    self._out.sendall(data)
            self._things.task_done()
        self._things.task_done()


class SlowLink:
    """Listens on `.port` and passes lines on to `port`, each direction of each line `delay_s()` later.

    `cuts`: (verb, its number, counted from 1) -> one of CUTS; the verb "" is the hello of a connection.
    request: half of it arrives, then both sides are cut; waiting: it arrives, and both are cut before the answer;
    answer: half of the answer arrives; ghost: as waiting, but the server's side stays open; for_good: as waiting, and
    nobody gets through any more.

    `asked` has (verb, args) of each request that came in, `delays_s` each delay; `silent`: nothing passes any more, and
    both sides stay open. Threads: its own; what it has may be read from any.
    """

    def __init__(
        self, port: int, seed: int, cuts: dict[tuple[str, int], str], longest_s: float = 2.0, every: int = 25
    ) -> None:
        assert set(cuts.values()) <= set(CUTS)
        self._to, self._cuts, self._longest_s, self._every = port, dict(cuts), longest_s, every
        self._random, self._lock = random.Random(seed), threading.Lock()
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.delays_s: list[float] = []
        self.cut: list[tuple[str, int, str]] = []
        self.silent = False
        self._open: list[socket.socket] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        threading.Thread(target=self._listen, daemon=True).start()

    def __enter__(self) -> SlowLink:
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Cuts everything, for good."""
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for link in self._open:
            hang_up(link)

    def delay_s(self) -> float:
        """Mostly short, so that a test ends; every so many-th as long as it gets."""
        with self._lock:
            longest = len(self.delays_s) % self._every == self._every - 1
            self.delays_s.append(self._longest_s * (1.0 if longest else self._random.random() ** 8))
            return self.delays_s[-1]

    def _listen(self) -> None:
        while True:
            try:
                near = self._listener.accept()[0]
                far = socket.create_connection(("127.0.0.1", self._to))
            except OSError:
                return
            self._open += [near, far]
            for link in (near, far):
                link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=self._connection, args=(near, far), daemon=True).start()

    def _connection(self, near: socket.socket, far: socket.socket) -> None:
        there, back = Way(far, self), Way(near, self)
        state = {"half": False}  # the next answer arrives by half
        threading.Thread(target=self._answers, args=(near, far, back, state), daemon=True).start()
        kind = ""
        for line in lines_of(near):
            kind = self._kind(line)
            state["half"] = kind == "answer"
            there.put(line[: len(line) // 2] if kind == "request" else line, self.delay_s())
            if kind in ("request", "waiting", "ghost", "for_good"):
                break
        there.end()
        if kind == "for_good":
            self.close()
        hang_up(near)
        if kind != "ghost":
            hang_up(far)

    def _answers(self, near: socket.socket, far: socket.socket, back: Way, state: dict[str, bool]) -> None:
        for line in lines_of(far):
            half = state["half"]
            back.put(line[: len(line) // 2] if half else line, self.delay_s())
            if half:
                break
        back.end()
        hang_up(near)
        hang_up(far)

    def _kind(self, line: bytes) -> str:
        request = json.loads(line)
        verb = str(request.get("verb", ""))
        with self._lock:
            self.asked.append((verb, request.get("args", {})))
            key = verb, sum(each == verb for each, _ in self.asked)
            kind = self._cuts.pop(key, "")
            if kind:
                self.cut.append((*key, kind))
        return kind


def lines_of(link: socket.socket) -> Any:
    """Each line with its end, until there are no more."""
    heard = b""
    while True:
        try:
            data = link.recv(PIECE_BYTES)
        except OSError:
            return
        if not data:
            return
        heard += data
        while (end := heard.find(b"\n")) >= 0:
            yield heard[: end + 1]
            heard = heard[end + 1 :]


def hang_up(link: socket.socket) -> None:
    """Both directions, also for a thread that waits on it."""
    with contextlib.suppress(OSError):
        link.shutdown(socket.SHUT_RDWR)
    link.close()
