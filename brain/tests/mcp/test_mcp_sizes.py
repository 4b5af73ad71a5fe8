# SPDX-License-Identifier: Apache-2.0
"""How much a model has to read: the tools, a status, the answer of a swap, a history; and where the whole is."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lithe.gateway.brief import brief_status
from lithe.mcp import permission
from lithe.mcp.protocol import encoded
from lithe.mcp.server import Server
from lithe.remote import Remote
from lithe.vocabulary import BY_NAME, VERBS
from system.robot_rig import ROOT

Json = dict[str, Any]
PROBES = """\
#include <lithe/law.hpp>
struct Two {
  struct Params {};
  struct State {};
  struct Probes { double a_nm = 0, b_nm = 0; };
  static void step(const lithe::Tick& t, const Params&, State&, lithe::Effort& u, Probes& pr) {
    for (std::uint32_t j = 0; j < t.joints; ++j)
      u.torque_nm[j] = 4.0 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    pr.a_nm = u.torque_nm[0] / 3.0;
    pr.b_nm = 1.0;
  }
};
LITHE_LAW(Two, "two");
"""


@pytest.fixture
def server(remote: Remote, tmp_path: Path) -> Server:
    permission.give(tmp_path / "may", 5)
    return Server(lambda verb, args: remote.call(verb, **args), tmp_path / "may")


def asked(server: Server, method: str, params: Json | None = None) -> Any:
    answers: list[Json] = []
    message = {"jsonrpc": "2.0", "id": 1, "method": method, "params": params or {}}
    server.line(json.dumps(message).encode(), answers.append)
    server.finish()
    return answers[0]["result"]


def tool(server: Server, verb: str, /, **args: Any) -> str:
    return str(asked(server, "tools/call", {"name": verb, "arguments": args})["content"][0]["text"])


def test_all_tools_have_8_kb_and_each_has_the_rest_on_request(server: Server) -> None:
    tools = asked(server, "tools/list")
    assert len(encoded(tools)) <= 8 << 10 and {each["name"] for each in tools["tools"]} == set(BY_NAME)
    for each in tools["tools"]:
        verb = BY_NAME[each["name"]]
        words = each["description"].partition(" [")[0]
        assert verb.what.startswith(words) and len(words) <= 80, "one whole sentence, not cut"
        assert set(each["inputSchema"].get("properties", {})) == set(verb.args) - {"dry_run"}
        assert each["inputSchema"].get("required", []) == list(verb.required)
    whole = json.loads(tool(server, "describe", verb="swap"))
    assert whole["args"]["properties"]["error_ratio"]["description"] and whole["tier"] == "swap"
    assert "no verb" in tool(server, "describe", verb="nonsense")


def test_a_status_has_1500_bytes_and_the_whole_on_request(server: Server, remote: Remote) -> None:
    for text in (tool(server, "status"), encoded(remote.call("status"))):
        told = json.loads(text)
        assert len(text) <= 1500 and told["mode"] == "active" and told["law"] and told["position_rad"]
    assert {"release_jitter_us", "joints", "health"} <= set(json.loads(tool(server, "status", brief=False)))


def test_a_status_of_32_joints_with_every_trouble_says_what_stopped_them() -> None:
    long = "x" * 400
    joints = [
        {"name": f"joint_{j}", "problems": ["fault", "not_ready"], "drive": long, "drive_state": "fault",
         "position_rad": 0.123456789}
        for j in range(32)
    ]  # fmt: skip
    told = brief_status({
        "mode": "safe_stop", "fault": "drive_fault", "law": "pd", "law_id": 3, "joints": joints,
        "alarms": [{"level": "stop", "text": f"safe stop by drive_fault {long}"}] * 20,
        "stopped_by": {"text": f"drive_fault at joint joint_3 {long}", "next": long, "tick": 7},
        "last_swap": {"verdict": "confirmed", "law": "pd"}, "params": {f"p{i}": 1.0 for i in range(32)},
    })  # fmt: skip
    assert len(json.dumps(told)) <= 1500
    assert told["fault"] == "drive_fault" and told["alarms"][0]["text"].startswith("safe stop by drive_fault")
    assert told["stopped_by"]["text"].startswith("drive_fault at joint joint_3") and told["problems"]


def test_the_answer_of_a_swap_has_2_kb_and_a_history_only_declared_probes(server: Server, remote: Remote) -> None:
    assert len(tool(server, "swap", source=(ROOT / "laws/gravity_pd.cpp").read_text(), wait=False)) <= 2000
    text = tool(server, "swap", source=PROBES, name="two.cpp", wait=False)
    assert len(text) <= 2000 and json.loads(text)["verdict"] and json.loads(text)["diff"]["lines"] > 10
    assert len(encoded(remote.call("swap", source=PROBES, name="two.cpp", brief=True, wait=False))) <= 2000, "over TCP"
    remote.call("swap", source=PROBES, name="two.cpp")
    short = remote.call("history", seconds=0.02, fields=["probe", "position_rad"])
    assert short["probe"] and all(len(row) == 2 for row in short["probe"])
    whole = remote.call("history", seconds=0.02, fields=["probe"], brief=False)
    assert all(len(row) == 8 for row in whole["probe"])
    assert all(round(value, 6) == value for row in short["probe"] + short["position_rad"] for value in row)
    assert len(VERBS) > 30


def test_a_history_has_the_error_at_the_time_of_the_sample(remote: Remote) -> None:
    fields = ["release_ns", "release_jitter_ns", "sample_ns", "setpoint_position_rad", "setpoint_velocity_rad_s",
              "position_rad", "sample_age_s", "error_rad"]  # fmt: skip
    told = {key: np.asarray(value) for key, value in remote.call("history", seconds=0.2, fields=fields).items()}
    age_s = (told["release_ns"] + told["release_jitter_ns"] - told["sample_ns"]) * 1e-9
    assert np.abs(told["sample_age_s"] - age_s).max() < 1e-6 and age_s.min() > 0
    error = told["setpoint_position_rad"] - told["setpoint_velocity_rad_s"] * age_s[:, None] - told["position_rad"]
    assert np.abs(told["error_rad"] - error).max() < 1e-5
    one = remote.call("latest", fields=["error_rad", "sample_age_s"])
    assert len(one["error_rad"]) == 1 and one["sample_age_s"] > 0
