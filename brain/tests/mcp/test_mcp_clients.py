# SPDX-License-Identifier: Apache-2.0
"""The protocol's own clients, its inspector and its conformance suite against `python -m lithe.mcp`."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import lithe
import pypi
import pytest
from lithe.agent.rounds import SAYS_NOTHING
from lithe.gateway import Gateway, documents
from lithe.gateway.token import write_token
from lithe.mcp import plots
from lithe.mcp.http import Endpoint, Handler
from lithe.mcp.protocol import HANDSHAKE, STATELESS
from lithe.mcp.server import Server
from lithe.vocabulary import BY_NAME
from mcp_endpoint import serving
from system.pypi import Package, had
from system.robot_rig import ROOT

Json = dict[str, Any]
PYTHON_SDK = "mcp==2.3.0"
NPM_SDK = "@modelcontextprotocol/sdk@1.32.2"
INSPECTOR = "@modelcontextprotocol/inspector@2.12.0"
CONFORMANCE = "@modelcontextprotocol/conformance@0.2.0-alpha.12"  # the first series that knows version 2026-07-28
CLIENTS = ROOT / "tests/mcp_clients"
TOKEN = "sesame"
# What the suite asks of any server. Its other scenarios call tools and prompts of the suite's own (`test_simple_text`),
# or are of capabilities that this server does not declare: completion, logging, subscriptions, elicitation, tasks.
SCENARIOS = {
    "server-initialize", "server-session-lifecycle", "ping", "tools-list", "resources-list", "prompts-list",
    "dns-rebinding-protection", "sep-2164-resource-not-found", "caching", "http-header-validation", "server-stateless",
    "input-required-result-validate-input", "input-required-result-unsupported-methods", "server-sse-polling",
    "server-sse-multiple-streams",
}  # fmt: skip
OF_THE_SUITE = "Not testable: server does not list the diagnostic tool"


class Known(Handler):
    """For programs that cannot send a token: whoever comes has it."""

    def parse_request(self) -> bool:
        """The request, with the token."""
        read = super().parse_request()
        if read:
            del self.headers["Authorization"]
            self.headers["Authorization"] = f"Bearer {TOKEN}"
        return read


@pytest.fixture
def endpoint(tmp_path: Path) -> Iterator[Endpoint]:
    """A server without a robot: it has the documents, and each other verb answers its own name."""
    answers = {"documents": lambda _: {"documents": documents.listed()},
               "document": lambda args: documents.read(args["name"], lambda: tmp_path)}  # fmt: skip
    server = Server(lambda verb, args: answers.get(verb, lambda _: verb)(args), tmp_path / "none")
    with serving(server, TOKEN) as made:
        yield made


def words(*more: str) -> tuple[list[str], dict[str, str]]:
    """The command of the server, and its environment."""
    return [sys.executable, "-m", "lithe.mcp", *more], os.environ | {"PYTHONPATH": str(ROOT / "brain")}


def ran(command: list[str | Path], timeout_s: float = 300, **more: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, check=False, **more)


def client(name: str, way: Json, calls: list[tuple[str, Json]]) -> Json:
    """What a client of the protocol's own says that it saw and was answered."""
    if name == "python":
        package = Package(PYTHON_SDK)
        done = ran(package.command(CLIENTS / "client.py", json.dumps(way), json.dumps(calls)), env=package.env)
    else:
        node, folder = had(pypi.install_npm, NPM_SDK)
        script = Path(shutil.copy(CLIENTS / "client.mjs", folder))
        done = ran([node, script, json.dumps(way), json.dumps(calls)])
    assert done.returncode == 0, done.stderr
    said: Json = json.loads(done.stdout)
    return said


@pytest.mark.parametrize(
    ("name", "over", "mode"),
    [
        ("python", "stdio", "auto"),
        pytest.param("python", "http", "legacy", marks=pytest.mark.long),
        pytest.param("npm", "stdio", "legacy", marks=pytest.mark.long),
        pytest.param("npm", "http", "legacy", marks=pytest.mark.long),
    ],
)
def test_an_official_client_lists_tries_swaps_tunes_and_goes_back(
    robot: lithe.Robot, tmp_path: Path, name: str, over: str, mode: str
) -> None:
    gateway = Gateway(robot, token=write_token(tmp_path / "token"))
    gateway.start()
    command, env = words("--port", str(gateway.port), "--token-file", str(tmp_path / "token"))
    law = (ROOT / "laws/gravity_pd.cpp").read_text()
    calls: list[tuple[str, Json]] = [
        ("law_check", {"source": law}), ("swap", {"source": law, "name": "gravity_pd.cpp"}),
        ("set_params", {"values": {"kp_nm_rad": 3.5}}), ("rollback", {}), ("swap", {"source": "int x;"}),
        ("hold", {}), ("arm", {}),
    ]  # fmt: skip
    server: subprocess.Popen[str] | None = None
    try:
        way: Json = {"command": command[0], "args": command[1:], "env": env, "mode": mode}
        if over == "http":
            server = subprocess.Popen([*command, "--http", "0"], env=env, stderr=subprocess.PIPE, text=True)
            assert server.stderr is not None
            found = re.search(r"(http://\S+), token in (\S+)", server.stderr.readline())
            assert found is not None
            way = {"url": found[1], "token": Path(found[2]).read_text().strip(), "mode": mode}
        refused = client(name, way, [("swap", {"source": law}), ("status", {})])
        assert [each["error"] for each in refused["answers"]] == [True, False], refused
        assert refused["answers"][0]["text"].startswith("no_permission")
        subprocess.run([*command, "allow"], env=env, check=True, capture_output=True)
        for _ in range(3):  # an answer that the machine was too busy says nothing of the client
            said = client(name, way, calls)
            if not any(each["text"].startswith(SAYS_NOTHING) for each in said["answers"]):
                break
    finally:
        subprocess.run([*command, "forbid"], env=env, check=True, capture_output=True)
        if server is not None:
            server.terminate()
            server.communicate()
        gateway.close()
    assert said["version"] == (STATELESS if mode == "auto" else HANDSHAKE[0])
    assert set(said["tools"]) == set(BY_NAME) and said["contract"] > 1000
    assert {"lithe://laws/pd.cpp", *(f"lithe://{each}" for each in plots.ALWAYS)} <= set(said["resources"])
    assert {f"lithe://{each}" for each in plots.OF_ONE} <= set(said["templates"])
    assert set(said["prompts"]) == {"identify_then_compensate", "explain_this_refusal", "improve_by_one_term"}
    assert [each["error"] for each in said["answers"]] == [False, False, False, False, True, False, False], said
    for size in said["pictures"].values():
        assert re.fullmatch(r"\d{4,6} bytes", size), said["pictures"]


@pytest.mark.long  # it downloads Node.js
def test_the_conformance_suite_finds_nothing_that_applies_to_this_server(endpoint: Endpoint, tmp_path: Path) -> None:
    node, folder = had(pypi.install_npm, CONFORMANCE)
    endpoint.RequestHandlerClass = Known
    url, out = f"http://127.0.0.1:{endpoint.server_port}/mcp", tmp_path / "results"
    script = folder / "node_modules/@modelcontextprotocol/conformance/dist/index.js"
    done = ran([node, script, "server", "--url", url, "--suite", "all", "-o", out])
    seen: dict[str, list[Json]] = {}
    for path in out.rglob("checks.json"):
        found = re.fullmatch(r"server-(.+)-\d{4}-\d\d-\d\dT.*", path.parent.name)
        assert found is not None, path
        seen[found[1]] = json.loads(path.read_text())
    assert set(seen) >= SCENARIOS, done.stdout + done.stderr
    for name, checks in seen.items():
        for each in checks:
            wrong = each["status"] == "FAILURE" and not str(each.get("errorMessage")).startswith(OF_THE_SUITE)
            assert not wrong or (name not in SCENARIOS and each["id"] != "wire-schema-valid"), (name, each)
    assert sum(each["status"] == "SUCCESS" for name in SCENARIOS for each in seen[name]) >= 60


@pytest.mark.long
@pytest.mark.parametrize("era", ["legacy", "modern"])
def test_the_inspector_lists_reads_and_calls(endpoint: Endpoint, tmp_path: Path, era: str) -> None:
    node, folder = had(pypi.install_npm, INSPECTOR)
    script = folder / "node_modules/@modelcontextprotocol/inspector/clients/launcher/build/index.js"
    url = f"http://127.0.0.1:{endpoint.server_port}/mcp"

    def inspect(*asked: str, token: str = TOKEN) -> tuple[int, str]:
        common = ["--cli", "--server-url", url, "--protocol-era", era, "--format", "json", "--quiet"]
        header = ["--header", f"Authorization: Bearer {token}"]
        done = ran([node, script, *common, *header, "--method", *asked], env=os.environ | {"HOME": str(tmp_path)})
        return done.returncode, done.stdout + done.stderr

    code, told = inspect("tools/list", "--strict")  # a schema that not all clients take is an error
    assert code == 0 and {each["name"] for each in json.loads(told)["result"]["tools"]} == set(BY_NAME), told
    for asked in (
        ["resources/list"],
        ["resources/templates/list"],
        ["prompts/list"],
        ["resources/read", "--uri", "lithe://contract"],
        ["prompts/get", "--prompt-name", "explain_this_refusal", "--prompt-args", "about=trial_failed"],
        ["tools/call", "--tool-name", "status"],
    ):
        code, told = inspect(*asked)
        assert code == 0 and json.loads(told)["result"], told
    code, told = inspect("tools/call", "--tool-name", "arm")
    assert code == 5 and "no_permission" in told, "it calls an error of a tool 5"
    code, told = inspect("resources/read", "--uri", "lithe://nothing")
    assert code != 0 and "there is no document" in told
    code, told = inspect("tools/list", token="wrong")
    assert code != 0 and "describe" not in told
