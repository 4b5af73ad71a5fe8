# SPDX-License-Identifier: Apache-2.0
"""MCP over HTTP: what is served, to whom, and what is refused."""

import contextlib
import http.client
import json
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from lithe.mcp.http import MOST_CLIENTS, Endpoint
from lithe.mcp.protocol import HANDSHAKE, META, MOST_LINE_BYTES, STATELESS, VERSIONS
from lithe.mcp.server import Server
from mcp_endpoint import serving

Json = dict[str, Any]
PING = json.dumps({"jsonrpc": "2.0", "id": 7, "method": "ping"}).encode()


@pytest.fixture
def endpoint(tmp_path: Path) -> Iterator[Endpoint]:
    """A server without a robot: each verb answers its own name."""
    with serving(Server(lambda verb, _: verb, tmp_path / "none"), "sesame") as made:
        yield made


def ask(
    endpoint: Endpoint, body: bytes = PING, method: str = "POST", path: str = "/mcp", **headers: str
) -> tuple[int, Json]:
    """Status and body of one request, with the right token if `headers` do not say otherwise."""
    with closing(http.client.HTTPConnection("127.0.0.1", endpoint.server_port, timeout=60)) as link:
        named = {"Authorization": "Bearer sesame", **{key.replace("_", "-"): value for key, value in headers.items()}}
        link.request(method, path, body, named)
        answer = link.getresponse()
        text = answer.read()
    return answer.status, json.loads(text) if text else {}


def test_a_message_is_answered_and_a_notification_is_taken(endpoint: Endpoint) -> None:
    assert ask(endpoint) == (200, {"jsonrpc": "2.0", "id": 7, "result": {}})
    tool = {"jsonrpc": "2.0", "id": "a", "method": "tools/call", "params": {"name": "status"}}
    status, answer = ask(endpoint, json.dumps(tool).encode(), MCP_Protocol_Version="2025-06-18")
    assert (status, answer["id"], answer["result"]["content"][0]["text"]) == (200, "a", '"status"')
    assert ask(endpoint, b'{"jsonrpc": "2.0", "method": "notifications/initialized"}') == (202, {})
    assert ask(endpoint, b"{")[1]["error"]["code"] == -32700


@pytest.mark.parametrize(
    ("status", "asked"),
    [
        (401, {"Authorization": "Bearer wrong"}),
        (401, {"Authorization": ""}),
        (403, {"Origin": "http://evil.example"}),
        (403, {"Host": "evil.example"}),
        (400, {"MCP_Protocol_Version": "1999-01-01"}),
        (400, {"MCP_Protocol_Version": STATELESS}),
        (404, {"path": "/"}),
        (405, {"method": "GET"}),
        (405, {"method": "DELETE"}),
        (413, {"Content_Length": str(MOST_LINE_BYTES + 1)}),
        (411, {"Transfer_Encoding": "chunked"}),
        (411, {"Content_Length": "-1"}),
    ],
)
def test_what_is_wrong_is_named_and_refused(endpoint: Endpoint, status: int, asked: dict[str, str]) -> None:
    got, answer = ask(endpoint, **asked)
    assert got == status and answer["error"]["message"], answer
    assert ask(endpoint)[0] == 200, "and the next client is served"


def stateless(method: str = "tools/list", version: str = STATELESS, **params: Any) -> bytes:
    """A request without a handshake."""
    meta = {META + "protocolVersion": version, META + "clientCapabilities": {}}
    return json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": {"_meta": meta, **params}}).encode()


@pytest.mark.parametrize(
    ("status", "code", "asked"),
    [
        (200, None, {"body": stateless()}),
        (200, None, {"body": stateless("server/discover"), "Mcp_Method": "server/discover"}),
        (200, None, {"body": stateless(), "Mcp_Method": "=?base64?dG9vbHMvbGlzdA==?="}),
        (400, -32020, {"body": stateless(), "Mcp_Method": "=?base64?dG9vbHMvb!!!=?="}),
        (400, -32020, {"body": stateless(), "Mcp_Method": "TOOLS/LIST"}),
        (400, -32020, {"body": stateless(), "MCP_Protocol_Version": HANDSHAKE[0]}),
        (400, -32020, {"body": stateless("tools/call", name="status"), "Mcp_Method": "tools/call", "Mcp_Name": "arm"}),
        (400, -32022, {"body": stateless(version="v999"), "MCP_Protocol_Version": "v999"}),
        (400, -32602, {"body": PING}),
        (404, -32601, {"body": stateless("ping"), "Mcp_Method": "ping"}),
    ],
)
def test_a_client_without_a_handshake_names_version_and_method(
    endpoint: Endpoint, status: int, code: int | None, asked: dict[str, Any]
) -> None:
    got, answer = ask(endpoint, **{"MCP_Protocol_Version": STATELESS, "Mcp_Method": "tools/list", **asked})
    assert (got, answer.get("error", {}).get("code")) == (status, code), answer
    if code is None:
        assert answer["result"]["resultType"] == "complete" and answer["result"]["ttlMs"] == 0
    if code == -32022:
        assert answer["error"]["data"] == {"supported": list(VERSIONS), "requested": "v999"}


def test_a_page_of_this_computer_may_ask(endpoint: Endpoint) -> None:
    for origin in ("http://localhost:6274", "http://127.0.0.1", "http://[::1]:80"):
        assert ask(endpoint, Origin=origin)[0] == 200


def test_clients_that_say_nothing_give_their_places_to_one_that_does(endpoint: Endpoint) -> None:
    with contextlib.ExitStack() as open_ones:
        for _ in range(MOST_CLIENTS + 5):
            open_ones.enter_context(socket.create_connection(("127.0.0.1", endpoint.server_port)))
        for _ in range(3):
            assert ask(endpoint)[0] == 200


def test_a_client_that_waits_for_its_answer_keeps_its_place(tmp_path: Path) -> None:
    go_on, begun = threading.Event(), threading.Semaphore(0)

    def verb(name: str, _: Json) -> str:
        begun.release()
        go_on.wait(60)
        return name

    tool = json.dumps({"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": {"name": "status"}}).encode()
    with contextlib.ExitStack() as open_ones:
        made = open_ones.enter_context(serving(Server(verb, tmp_path / "none"), "sesame"))
        pool = open_ones.enter_context(ThreadPoolExecutor(8))
        open_ones.callback(go_on.set)
        answers = [pool.submit(ask, made, tool) for _ in range(8)]
        assert all(begun.acquire(timeout=20) for _ in answers)
        for _ in range(MOST_CLIENTS):
            open_ones.enter_context(socket.create_connection(("127.0.0.1", made.server_port)))
        assert ask(made)[0] == 200
        go_on.set()
        assert {each.result()[0] for each in answers} == {200}
