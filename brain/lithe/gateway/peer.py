# SPDX-License-Identifier: Apache-2.0
"""Who a client of the gateway is. One that names a secret in its hello is the same over all its connections: those at a
time, and those after one that broke. Its lease and its reference are the client's, not a connection's.
"""

from __future__ import annotations

import os
import socket
import threading
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from ..robot import Robot
from ..vocabulary import Tier

AWAY_S = 10.0  # two ways there and back on a link that takes 2 s, and a pause before the next try
LEAST_SECRET, MOST_SECRET = 16, 64  # characters


@dataclass(frozen=True)
class Peer:
    """`key`: equal for the same client, and told to nobody; `name`: the address of this connection's other end;
    `lasts`: it can come back; `tier`: what its token lets it do.
    """

    key: object
    name: str = field(compare=False)
    lasts: bool = field(compare=False)
    tier: Tier = field(compare=False, default=Tier.move)


def peer_of(link: socket.socket, hello: dict[str, Any], tier: Tier) -> Peer:
    """Who says that hello; without a secret of a good length in `client` it is a client of its own."""
    secret = hello.get("client")
    lasts = isinstance(secret, str) and LEAST_SECRET <= len(secret) <= MOST_SECRET
    try:
        host, port = link.getpeername()[:2]
        name = f"client {host}:{port}"
    except OSError:
        name = "a client that has left"
    return Peer(secret if lasts else object(), name, lasts, tier)


class Peers:
    """Counts the connections of each client. Threads: all methods may be called from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._connections: Counter[object] = Counter()

    def came(self, link: socket.socket, hello: dict[str, Any], tier: Tier) -> Peer:
        """A connection more."""
        peer = peer_of(link, hello, tier)
        with self._lock:
            self._connections[peer.key] += 1
        return peer

    def left(self, peer: Peer) -> bool:
        """A connection less; True when it was the client's last one."""
        with self._lock:
            self._connections[peer.key] -= 1
            last = self._connections[peer.key] <= 0
            if last:
                del self._connections[peer.key]
        return last


class Pressed:
    """Who pressed the e-stop that this gateway holds: a client is told so, and not to look for a process.

    Threads: all methods may be called from any thread.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._by: Peer | None = None

    def estop(self, client: Peer | None) -> Any:
        """At once. `client`: None for one without a place (gateway/__init__.py)."""
        self._by = client
        return self._robot.estop()

    def reset(self) -> Any:
        """Clears the e-stop of this process, and the Spine's."""
        self._by = None
        return self._robot.reset()

    def told(self, status: dict[str, Any], client: Peer | None) -> dict[str, Any]:
        """The status with the alarm of an e-stop that this gateway holds in words for that client."""
        held, by = str(status.get("estop_held_by", "")), self._by
        if held.partition(" (")[0] != f"pid {os.getpid()}":
            return status
        who = "this client" if by is not None and by == client else by.name if by is not None else "this gateway"
        words = f"the e-stop was pressed by {who}: find out why, then: reset, arm"
        alarms = [each | {"text": words} if held in each["text"] else each for each in status.get("alarms") or []]
        return status | {"alarms": alarms}
