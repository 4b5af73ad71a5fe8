# SPDX-License-Identifier: Apache-2.0
"""Raw words with a gateway, as a program writes them that was not made for it."""

from __future__ import annotations

import json
import socket
from typing import Any

from lithe.gateway import Gateway


def lines(gateway: Gateway, *sent: bytes) -> list[dict[str, Any]]:
    """Raw lines in, raw answers out, until the gateway hangs up."""
    with socket.create_connection(("127.0.0.1", gateway.port), 30) as link:
        try:
            link.sendall(b"".join(sent))
            link.shutdown(socket.SHUT_WR)
        except OSError:
            pass  # it hung up on us, as it should: the answer is there to read
        with link.makefile("rb") as file:
            return [json.loads(line) for line in file]


def ask(gateway: Gateway, request: bytes) -> dict[str, Any]:
    return lines(gateway, b'{"token": "sesame"}\n', request + b"\n")[1]
