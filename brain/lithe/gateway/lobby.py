# SPDX-License-Identifier: Apache-2.0
"""Where the gateway's clients wait until they have shown the token: apart from the places of those that have.

One thread serves them all without ever waiting for one. Who shows no token within HELLO_S is shown out. When too many
wait, of one address or in all, the one that has waited longest goes: so nobody without a token keeps others out, not
even from the same address.
"""

from __future__ import annotations

import contextlib
import hmac
import json
import selectors
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ..vocabulary import Tier

HELLO_S = 6.0  # an SSH tunnel connects here, and tells what its client said a way there and back later
MOST_HELLO_BYTES = 4096
MOST_WAITING = 64
MOST_OF_ONE_ADDRESS = 16
MOST_LEFT_BYTES = 1 << 20  # discarded input of a refused client: closing with unread input would drop the answer

Hello = dict[str, Any]


@dataclass
class Guest:
    """A client without a valid token so far, or a refused one that gets time to read the reason."""

    link: socket.socket
    address: str
    until_s: float
    heard: bytes = b""
    leaving: bool = False
    thrown_away_bytes: int = field(default=0)


class Lobby:
    """Listens on `host`:`port` (0: any free one) and gives each who knows one of `tokens` to `admit`.

    `admit(link, hello, rest, tier)` gets the connected socket, what the client said first and what it has sent since,
    and the tier of its token. It returns None when it took the client, else the line to refuse it with; it must not
    wait.
    """

    def __init__(
        self,
        host: str,
        port: int,
        tokens: dict[str, Tier],
        admit: Callable[[socket.socket, Hello, bytes, Tier], bytes | None],
        no: bytes,
    ) -> None:
        self._tokens, self._admit, self._no = {word.encode(): tier for word, tier in tokens.items()}, admit, no
        self._guests: dict[int, Guest] = {}  # by file descriptor, who came first before the others
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._listener = socket.create_server((host, port), family=family, backlog=128)
        self._listener.setblocking(False)
        self.port = int(self._listener.getsockname()[1])
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._wake, self._woken = socket.socketpair()
        self._selector.register(self._woken, selectors.EVENT_READ)
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Serves in a thread of its own until close()."""
        self._thread = threading.Thread(target=self._run, name="lithe-gateway", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Accepts no more clients and disconnects those that wait."""
        self._wake.close()
        if self._thread is not None:
            self._thread.join()
        self._listener.close()
        for guest in list(self._guests.values()):
            self._show_out(guest)
        self._woken.close()
        self._selector.close()

    def _run(self) -> None:
        while True:
            soonest_s = min((guest.until_s for guest in self._guests.values()), default=None)
            timeout_s = None if soonest_s is None else max(0.0, soonest_s - time.monotonic())
            for key, _ in self._selector.select(timeout_s):
                if key.fileobj is self._woken:
                    return
                if key.fileobj is self._listener:
                    self._welcome()
                elif (guest := self._guests.get(key.fd)) is not None:
                    self._hear(guest)
            now_s = time.monotonic()
            for guest in [each for each in self._guests.values() if each.until_s <= now_s]:
                self._show_out(guest)

    def _welcome(self) -> None:
        try:
            link, address = self._listener.accept()
        except OSError:  # it has disconnected, or no file descriptor is free
            if self._guests:
                self._show_out(next(iter(self._guests.values())))
            else:
                time.sleep(0.01)
            return
        link.setblocking(False)
        guest = Guest(link, str(address[0]), time.monotonic() + HELLO_S)
        neighbours = [each for each in self._guests.values() if each.address == guest.address]
        if len(neighbours) >= MOST_OF_ONE_ADDRESS:
            self._show_out(neighbours[0])
        elif len(self._guests) >= MOST_WAITING:
            self._show_out(next(iter(self._guests.values())))
        self._guests[link.fileno()] = guest
        self._selector.register(link, selectors.EVENT_READ)

    def _hear(self, guest: Guest) -> None:
        try:
            data = guest.link.recv(MOST_HELLO_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        guest.thrown_away_bytes += len(data) if guest.leaving else 0
        if not data or guest.thrown_away_bytes > MOST_LEFT_BYTES:
            self._show_out(guest)
            return
        if guest.leaving:
            return
        guest.heard += data
        line, newline, rest = guest.heard.partition(b"\n")
        if newline or len(guest.heard) > MOST_HELLO_BYTES:
            self._answer(guest, line, rest)

    def _answer(self, guest: Guest, line: bytes, rest: bytes) -> None:
        hello: Any = None
        with contextlib.suppress(ValueError, RecursionError):
            hello = json.loads(line)
        given = str(hello.get("token", "")).encode(errors="replace") if isinstance(hello, dict) else b""
        refusal = self._no
        tiers = [tier for token, tier in self._tokens.items() if hmac.compare_digest(given, token)]
        if tiers:
            number = guest.link.fileno()
            self._selector.unregister(guest.link)
            busy = self._admit(guest.link, hello, rest, tiers[0])
            if busy is None:
                del self._guests[number]
                return
            self._selector.register(guest.link, selectors.EVENT_READ)
            refusal = busy
        with contextlib.suppress(OSError):
            guest.link.send(refusal)
            guest.link.shutdown(socket.SHUT_WR)
        guest.leaving, guest.heard = True, b""

    def _show_out(self, guest: Guest) -> None:
        del self._guests[guest.link.fileno()]
        self._selector.unregister(guest.link)
        guest.link.close()
