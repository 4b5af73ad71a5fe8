# SPDX-License-Identifier: Apache-2.0
"""MCP over HTTP ("streamable HTTP"), on this computer only: one POST to /mcp for each message, answered with JSON.

Without sessions and without a stream from the server, as the protocol allows. A web page in a browser of this computer
could send requests, too: so a request needs the token of a file of mode 0600, and names of other hosts are refused.
"""

from __future__ import annotations

import contextlib
import hmac
import queue
import socket
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

from ..control import run_dir
from ..errors import LitheError
from ..gateway.token import write_token
from .protocol import MOST_LINE_BYTES, REQUEST, Json, answer, encoded, http_status
from .server import Server

PATH = "/mcp"
HERE = ("127.0.0.1", "localhost", "::1")
MOST_CLIENTS = 32  # connections at a time
LEAVE_S = 1.0  # how long one that is ended may take to leave its place
BODY_S = 10.0  # how long a client may take to send its request, and to begin the next one


class Endpoint(ThreadingHTTPServer):
    """Serves one Server on 127.0.0.1:`port` (0: any free one) to those who have `token`; nobody while it is empty."""

    daemon_threads = True

    def __init__(self, server: Server, port: int, token: str = "") -> None:
        self.mcp, self.token = server, token
        self.places = threading.BoundedSemaphore(MOST_CLIENTS)
        self.idle: dict[socket.socket, None] = {}  # connections without a request, the longest so first
        self.lock = threading.Lock()
        super().__init__(("127.0.0.1", port), Handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """One connection more. Without a place the one that is idle the longest ends, or this one: none is idle."""
        if not self.places.acquire(blocking=False) and not (self._end_idle() and self.places.acquire(timeout=LEAVE_S)):
            self.shutdown_request(request)
            return
        self.now_idle(request)
        super().process_request(request, client_address)

    def now_idle(self, request: socket.socket) -> None:
        """A connection waits for its next request."""
        with self.lock:
            self.idle[request] = None

    def now_busy(self, request: socket.socket) -> None:
        """A connection has a request, or has ended."""
        with self.lock:
            self.idle.pop(request, None)

    def _end_idle(self) -> bool:
        """End the connection that is idle the longest; whether there was one."""
        with self.lock:
            if not self.idle:
                return False
            self.idle.pop(first := next(iter(self.idle)))
            with contextlib.suppress(OSError):
                first.shutdown(socket.SHUT_RDWR)  # its thread reads the end of it, and leaves
        return True

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Until the connection ends."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self.now_busy(request)
            self.places.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that left while it was answered is no news."""


class Handler(BaseHTTPRequestHandler):
    """One connection of a client."""

    server: Endpoint
    protocol_version = "HTTP/1.1"
    timeout = BODY_S

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing."""

    def handle_one_request(self) -> None:
        """One request, from when the client may send it until it is answered."""
        super().handle_one_request()
        self.server.now_idle(self.connection)

    def parse_request(self) -> bool:
        """The request, once all of its headers have come."""
        read = super().parse_request()
        self.server.now_busy(self.connection)
        return read

    def do_POST(self) -> None:
        """One message of the protocol."""
        if (wrong := self._wrong()) is not None:
            return self._say(*wrong)
        body = self.rfile.read(int(self.headers["Content-Length"]))
        answers: queue.SimpleQueue[Json] = queue.SimpleQueue()
        if self.server.mcp.line(body, answers.put, self.headers.get):
            told = answers.get()
            return self._say(http_status(told, self.headers.get), told)
        return self._say(202, None)

    def do_GET(self) -> None:
        """A stream from the server: there is none."""
        self._say(405, _words("this server sends nothing by itself: POST each message"), Allow="POST")

    def do_DELETE(self) -> None:
        """The end of a session: there is none."""
        self.do_GET()

    def _wrong(self) -> tuple[int, Json] | None:
        """What is wrong with a request, before its body is read."""
        for name in ("Origin", "Host"):
            said = self.headers.get(name)
            if said is not None and urlsplit(said if "//" in said else f"//{said}").hostname not in HERE:
                return 403, _words(f"{name} {said!r} is not this computer")
        if not self.server.token or not hmac.compare_digest(
            self.headers.get("Authorization", "").encode(), f"Bearer {self.server.token}".encode()
        ):
            return 401, _words(
                "the header `Authorization: Bearer TOKEN` is missing or wrong: the server prints its file"
            )
        if urlsplit(self.path).path != PATH:
            return 404, _words(f"there is {PATH} only")
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or "Transfer-Encoding" in self.headers:
            return 411, _words("a request has a Content-Length")
        if int(length) > MOST_LINE_BYTES:
            return 413, _words(f"a message has at most {MOST_LINE_BYTES} bytes")
        return None

    def _say(self, status: int, body: Json | None, **headers: str) -> None:
        text = b"" if body is None else encoded(body).encode()
        self.send_response(status)
        for name, value in {**headers, "Content-Length": str(len(text))}.items():
            self.send_header(name, value)
        if text:
            self.send_header("Content-Type", "application/json")
        if status >= 400:  # what follows may be the body that was not read
            self.send_header("Connection", "close")
            self.close_connection = True
        self.end_headers()
        self.wfile.write(text)


def _words(message: str) -> Json:
    return answer(None, error={"code": REQUEST, "message": message})


def serve(server: Server, port: int) -> int:
    """Until Ctrl-C. The token is written to the run folder; where, and the address, are printed."""
    try:
        endpoint = Endpoint(server, port)
    except (OSError, OverflowError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise LitheError(f"cannot listen on 127.0.0.1:{port} ({why})\n  next: another --http PORT") from None
    path = run_dir() / f"mcp-{endpoint.server_port}.token"
    endpoint.token = write_token(path)
    print(f"lithe.mcp: http://127.0.0.1:{endpoint.server_port}{PATH}, token in {path}", file=sys.stderr, flush=True)
    try:
        endpoint.serve_forever()
    except KeyboardInterrupt:
        pass
    finally:
        endpoint.server_close()
        server.finish()
    return 0
