# SPDX-License-Identifier: Apache-2.0
"""The two connections of a robot, as bytes: its control socket and a gateway."""

import contextlib
import json
import os
import socket
from collections.abc import Iterator
from typing import Any

from calm import connected
from lithe.gateway import Gateway
from system.robot_rig import RobotRig


class Connection:
    """A connection that speaks lines."""

    def __init__(self, link: socket.socket) -> None:
        """Take a connected socket."""
        self.link = link
        self.link.settimeout(60)
        self.lines = link.makefile("rb")

    def say(self, line: bytes) -> dict[str, Any]:
        """One line out, one answer back."""
        self.link.sendall(line + b"\n")
        answer: dict[str, Any] = json.loads(self.lines.readline())
        return answer

    def ask(self, verb: str, **args: Any) -> dict[str, Any]:
        """One request, and its answer as it stands on the wire."""
        return self.say(json.dumps({"id": 1, "verb": verb, "args": args}).encode())


@contextlib.contextmanager
def both_connections(rig: RobotRig) -> Iterator[tuple[Connection, Connection]]:
    """The control socket, and a gateway of its own for the robot that runs there."""
    before = dict(os.environ)
    os.environ.update({key: value for key, value in rig.env.items() if key.startswith("LITHE_")})
    try:
        with connected() as robot, socket.socket(socket.AF_UNIX) as near:
            near.connect(str(rig.socket))
            gateway = Gateway(robot, token="sesame")
            gateway.start()
            with socket.create_connection(("127.0.0.1", gateway.port)) as far:
                tcp = Connection(far)
                assert tcp.say(b'{"token": "sesame"}') == {"ok": True}
                yield Connection(near), tcp
            gateway.close()
    finally:
        os.environ.clear()
        os.environ.update(before)
