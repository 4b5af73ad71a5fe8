# SPDX-License-Identifier: Apache-2.0
"""MCP over HTTP: what is served, to whom, and what is refused; and npm's client over both ways."""

import http.client
import json
import os
import re
import shutil
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import lithe
import pytest
from lithe.gateway import Gateway
from lithe.gateway.token import write_token
from lithe.mcp.http import MOST_CLIENTS, Endpoint
from lithe.mcp.server import MOST_LINE_BYTES, Server
from lithe.vocabulary import BY_NAME
from system.robot_rig import ROOT

Json = dict[str, Any]
PING = json.dumps({"jsonrpc": "2.0", "id": 7, "method": "ping"}).encode()


@pytest.fixture
def endpoint(tmp_path: Path) -> Iterator[Endpoint]:
    """A server without a robot: each verb answers its own name."""
    made = Endpoint(Server(lambda verb, _: verb, tmp_path / "none"), 0, "sesame")
    thread = threading.Thread(target=made.serve_forever)
    thread.start()
    yield made
    made.shutdown()
    thread.join()
    made.server_close()


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


def test_a_page_of_this_computer_may_ask(endpoint: Endpoint) -> None:
    for origin in ("http://localhost:6274", "http://127.0.0.1", "http://[::1]:80"):
        assert ask(endpoint, Origin=origin)[0] == 200


def test_clients_that_say_nothing_take_no_more_than_their_places(endpoint: Endpoint) -> None:
    silent = [socket.create_connection(("127.0.0.1", endpoint.server_port)) for _ in range(MOST_CLIENTS + 5)]
    with pytest.raises((OSError, http.client.HTTPException)):
        ask(endpoint)
    for each in silent:
        each.close()
    for _ in range(1000):
        try:
            assert ask(endpoint)[0] == 200
            break
        except (OSError, http.client.HTTPException):
            continue
    else:
        pytest.fail("the places were not given back")


def words(*more: str) -> tuple[list[str], dict[str, str]]:
    """The command of the server, and its environment."""
    return [sys.executable, "-m", "lithe.mcp", *more], os.environ | {"PYTHONPATH": str(ROOT / "brain")}


def npm_client(way: Json, calls: list[tuple[str, Json]]) -> Json:
    """What npm's client saw. It is not installed by tools/setup: 100 packages for one test."""
    folder = ROOT / "build/npm"
    if not (folder / "node_modules/@modelcontextprotocol/sdk").exists() or shutil.which("node") is None:
        pytest.skip("no MCP client of npm: npm install --prefix build/npm @modelcontextprotocol/sdk")
    script = folder / "client.mjs"
    shutil.copy(ROOT / "tests/npm/client.mjs", script)
    done = subprocess.run(
        ["node", script, json.dumps(way), json.dumps(calls)], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    said: Json = json.loads(done.stdout)
    return said


@pytest.mark.parametrize("over", ["stdio", "http"])
def test_npms_client_lists_tries_swaps_tunes_and_goes_back(robot: lithe.Robot, tmp_path: Path, over: str) -> None:
    gateway = Gateway(robot, token=write_token(tmp_path / "token"))
    gateway.start()
    common = ["--port", str(gateway.port), "--token-file", str(tmp_path / "token")]
    command, env = words(*common)
    law = (ROOT / "laws/gravity_pd.cpp").read_text()
    calls: list[tuple[str, Json]] = [
        ("law_check", {"source": law}), ("swap", {"source": law, "name": "gravity_pd.cpp", "probation_s": 0}),
        ("set_params", {"values": {"kp_nm_rad": 3.5}}), ("rollback", {}), ("swap", {"source": "int x;"}),
        ("hold", {}), ("arm", {}),
    ]  # fmt: skip
    server: subprocess.Popen[str] | None = None
    try:
        way: Json = {"command": command[0], "args": command[1:], "env": env}
        if over == "http":
            server = subprocess.Popen([*command, "--http", "0"], env=env, stderr=subprocess.PIPE, text=True)
            assert server.stderr is not None
            found = re.search(r"(http://\S+), token in (\S+)", server.stderr.readline())
            assert found is not None
            way = {"url": found[1], "token": Path(found[2]).read_text().strip()}
        refused = npm_client(way, [("swap", {"source": law})])
        assert refused["answers"][0]["error"] and refused["answers"][0]["text"].startswith("no_permission")
        subprocess.run([*command, "allow"], env=env, check=True, capture_output=True)
        said = npm_client(way, calls)
    finally:
        subprocess.run([*command, "forbid"], env=env, check=True, capture_output=True)
        if server is not None:
            server.terminate()
            server.communicate()
        gateway.close()
    assert set(said["tools"]) == set(BY_NAME) and said["contract"] > 1000
    assert "lithe://laws/pd.cpp" in said["resources"] and "explain_this_refusal" in said["prompts"]
    assert [each["error"] for each in said["answers"]] == [False, False, False, False, True, False, False], said
