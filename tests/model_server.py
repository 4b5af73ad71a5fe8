# SPDX-License-Identifier: Apache-2.0
"""A language model's server for tests: answers as real ones do, with what a test has put into its script."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any

HUGE_BYTES = 100 << 20


def law(body: str, name: str = "proposal", state: str = "") -> str:
    """A whole law of which `body` is the loop's inside, for joint j; `e` and `de` are its errors."""
    return (
        "#include <lithe/law.hpp>\n"
        "struct Proposal {\n  struct Params {};\n  struct State {" + state + "};\n"
        "  static void step(const lithe::Tick& t, const Params&, State& s, lithe::Effort& u) {\n"
        "    (void)s;\n"
        "    for (std::uint32_t j = 0; j < t.joints; ++j) {\n"
        "      const double e = t.setpoint_position_rad[j] - t.position_rad[j];\n"
        "      const double de = t.setpoint_velocity_rad_s[j] - t.velocity_rad_s[j];\n"
        "      (void)e; (void)de;\n"
        f"      {body}\n"
        "    }\n  }\n};\n"
        f'LITHE_LAW(Proposal, "{name}");\n'
    )


def fenced(source: str, word: str = "cpp") -> str:
    """As models show code."""
    return f"Here is the law:\n\n```{word}\n{source}```\n"


class ModelServer:
    """Answers the n-th question with the n-th entry of `script`, the last one again and again.

    An entry is the text of the answer; or an object: `message` (whole), `finish` (finish_reason), `status`, `hang` [s],
    `drop`, `huge`, `raw` (bytes instead of JSON), `short` (fewer bytes than announced), `drip` [s between bytes].
    """

    def __init__(self, script: list[Any], ollama: bool = False) -> None:
        self.script, self.ollama = script, ollama
        self.asked: list[dict[str, Any]] = []
        self.paths: list[str] = []
        self.keys: list[str | None] = []
        self.ended = threading.Event()
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                outer._version(self)

            def do_POST(self) -> None:
                with contextlib.suppress(OSError):  # the client has left
                    outer._chat(self)

            def log_message(self, *_: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True)

    def __enter__(self) -> ModelServer:
        self._thread.start()
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self.ended.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def _version(self, handler: BaseHTTPRequestHandler) -> None:
        found = self.ollama and handler.path == "/api/version"
        body = b'{"version": "0.9.1"}' if found else b'{"detail": "Not Found"}'
        handler.send_response(200 if found else 404)
        handler.send_header("Content-Length", str(len(body)))
        handler.end_headers()
        handler.wfile.write(body)

    def _chat(self, handler: BaseHTTPRequestHandler) -> None:
        self.paths.append(handler.path)
        self.keys.append(handler.headers.get("Authorization"))
        self.asked.append(json.loads(handler.rfile.read(int(handler.headers["Content-Length"]))))
        entry = self.script[min(len(self.asked), len(self.script)) - 1]
        one: dict[str, Any] = {"message": {"role": "assistant", "content": entry}} if isinstance(entry, str) else entry
        if "hang" in one:
            self.ended.wait(one["hang"])
        if one.get("drop") or "hang" in one:
            handler.close_connection = True
            return
        body = one.get("raw") or json.dumps(self._answer(one)).encode()
        handler.send_response(one.get("status", 200))
        handler.send_header("Content-Type", "application/json")
        handler.send_header("Content-Length", str(HUGE_BYTES if one.get("huge") else len(body) + one.get("short", 0)))
        handler.end_headers()
        if one.get("huge"):
            for _ in range(HUGE_BYTES >> 16):
                handler.wfile.write(b" " * (1 << 16))
        for byte in body if "drip" in one else b"":
            handler.wfile.write(bytes([byte]))
            if self.ended.wait(one["drip"]):
                return
        if "drip" not in one:
            handler.wfile.write(body)

    def _answer(self, one: dict[str, Any]) -> dict[str, Any]:
        message = one.get("message", {"role": "assistant", "content": ""})
        finish = one.get("finish", "stop")
        if self.ollama:
            return {"message": message, "done": True, "done_reason": finish, "prompt_eval_count": one.get("used", 900)}
        made = {"index": 0, "message": message, "finish_reason": finish}
        return {"created": int(time.time()), "choices": [made], "usage": {"prompt_tokens": 900}}


def tool_call(arguments: Any) -> dict[str, Any]:
    """A message with one call of a tool."""
    call = {"id": "call_1", "type": "function", "function": {"name": "propose_law", "arguments": arguments}}
    return {"message": {"role": "assistant", "content": None, "tool_calls": [call]}}
