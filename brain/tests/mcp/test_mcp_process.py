# SPDX-License-Identifier: Apache-2.0
"""`python -m lithe.mcp` on stdin and stdout: a swap by a client that knows nothing else, and a person's permission."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import lithe
import pytest
from lithe.gateway import Gateway
from lithe.gateway.token import write_token
from system.robot_rig import ROOT

Json = dict[str, Any]


def text(result: Json) -> str:
    return str(result["content"][0]["text"])


class Process:
    """`python -m lithe.mcp` as a client starts it."""

    def __init__(self, gateway: Gateway, token: Path) -> None:
        self.words = [sys.executable, "-m", "lithe.mcp", "--port", str(gateway.port), "--token-file", str(token)]
        self.env = os.environ | {"PYTHONPATH": str(ROOT / "brain")}
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(self.words, stdin=pipe, stdout=pipe, env=self.env)
        self.id = 0

    def person(self, *words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*self.words, *words], check=False, env=self.env, capture_output=True, text=True)

    def tool(self, name: str, /, **args: Any) -> Json:
        assert self.process.stdin is not None and self.process.stdout is not None
        self.id += 1
        params = {"name": name, "arguments": args}
        line = json.dumps({"jsonrpc": "2.0", "id": self.id, "method": "tools/call", "params": params})
        self.process.stdin.write(line.encode() + b"\n")
        self.process.stdin.flush()
        answer = json.loads(self.process.stdout.readline())
        assert answer["id"] == self.id
        result: Json = answer["result"]
        return result


@pytest.fixture
def process(robot: lithe.Robot, tmp_path: Path) -> Iterator[Process]:
    gateway = Gateway(robot, token=write_token(tmp_path / "token"))
    gateway.start()
    started = Process(gateway, tmp_path / "token")
    yield started
    started.person("forbid")
    assert started.process.stdin is not None and started.process.stdout is not None
    started.process.stdin.close()
    assert started.process.wait(60) == 0, "it ends with its client"
    started.process.stdout.close()
    gateway.close()


def test_a_client_that_knows_only_mcp_changes_the_law_and_goes_back(process: Process) -> None:
    told = json.loads(text(process.tool("describe")))
    assert told["robot"] == "arm" and "verbs" not in told, "tools/list has them"
    law = (ROOT / "laws/gravity_pd.cpp").read_text()
    assert not process.tool("law_check", source=law)["isError"]
    assert text(process.tool("swap", source=law)).startswith("no_permission")
    assert process.person("allow", "--minutes", "0").returncode == 1
    allowed = process.person("allow", "--minutes", "5")
    assert allowed.returncode == 0 and "agents have tier move" in allowed.stdout
    before = json.loads(text(process.tool("status")))["law"]
    certificate = json.loads(text(process.tool("swap", source=law, name="gravity_pd.cpp")))
    assert certificate["verdict"] in ("confirmed", "unproven"), "it waited for the verdict"
    assert set(certificate["joints"]["shoulder"]["rms_error_rad"]) == {"old", "new", "predicted", "new_late"}
    assert json.loads(text(process.tool("status")))["law"] != before
    assert not process.tool("rollback")["isError"]
    wrong = process.tool("swap", source=law, probation=1)
    assert wrong["isError"] and "did you mean 'probation_s'?" in text(wrong)
    assert process.person("forbid").returncode == 0
    assert text(process.tool("arm")).startswith("no_permission")
    assert not process.tool("hold")["isError"] and not process.tool("estop")["isError"]
