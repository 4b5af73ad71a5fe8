# SPDX-License-Identifier: Apache-2.0
"""What each tier of a token permits: every verb by every tier, and the ways around them."""

import json
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import lithe
import pytest
from lithe.gateway import Gateway
from lithe.gateway.token import lower
from lithe.mcp import permission
from lithe.mcp.server import Server
from lithe.remote import Remote
from lithe.vocabulary import VERBS, Tier
from system.robot_rig import ROOT

PD = (ROOT / "laws/pd.cpp").read_text()
# What a verb needs, said once more, by hand. All others need nothing.
NEEDS = {
    "set_params": Tier.tune, "revert_params": Tier.tune,
    "swap": Tier.swap, "shadow": Tier.swap, "rollback": Tier.swap, "activate": Tier.swap,
    "publish": Tier.move, "set_inputs": Tier.move, "set_reference": Tier.move, "arm": Tier.move,
    "recover": Tier.move, "reset": Tier.move, "sim_reset": Tier.move,
    "shutdown": Tier.person, "sim_truth": Tier.person,
}  # fmt: skip
# Arguments that need more than the verb alone.
MORE: list[tuple[str, dict[str, Any], Tier]] = [
    ("lease", {"take": True}, Tier.tune),
    ("lease", {"seconds": 5}, Tier.tune),
    ("disarm", {"now": True}, Tier.person),
]
ALL = [(each.name, {}, NEEDS.get(each.name, Tier.observe)) for each in VERBS] + MORE
FENCES = [("probation_s", 0.0), ("probation_s", 0.5), ("error_ratio", 0.0), ("error_ratio", 50.0), ("budget_us", 900.0)]


def refused(call: Any, *args: Any, **words: Any) -> str:
    """The code of the refusal; "": it was none."""
    try:
        call(*args, **words)
    except lithe.Refused as refusal:
        return refusal.code
    return ""


@pytest.mark.parametrize("tier", Tier)
def test_every_verb_by_every_tier(gateway: Gateway, tier: Tier) -> None:
    """The gateway's fixture has tier person. What would end the robot is asked only by those who may not."""
    token = "sesame" if tier is Tier.person else lower("sesame", tier)
    with Remote("127.0.0.1", gateway.port, token) as client:
        assert client.call("describe")["tier"] == tier.name
        for verb, args, needed in ALL:
            if needed > tier:
                assert refused(client.call, verb, **args) == "no_permission", (verb, args)
            elif verb not in ("shutdown", "estop"):  # an e-stop has its own test in test_gateway.py
                assert refused(client.call, verb, **args) != "no_permission", (verb, args)
        assert (refused(client.call, "add", a=1, b=2) == "no_permission") == (tier < Tier.move), "an application's"
        client.call("lease", take=False)


def test_a_lower_token_gives_no_higher_one(gateway: Gateway) -> None:
    tune = lower("sesame", Tier.tune)
    for token in (lower(tune, Tier.move), lower(tune, Tier.tune), "move" + tune.removeprefix("tune"), "move-", "tune"):
        with pytest.raises(lithe.Refused, match="wrong token"):
            Remote("127.0.0.1", gateway.port, token).call("ping")


def test_a_token_is_no_more_than_its_gateway(robot: lithe.Robot, tmp_path: Path) -> None:
    gateway = Gateway(robot, token="sesame")
    gateway.start()
    with Remote("127.0.0.1", gateway.port, "sesame") as agent:
        assert agent.call("describe")["tier"] == "move", "an agent's, if nothing is said"
        assert refused(agent.call, "shutdown") == "no_permission"
    with pytest.raises(lithe.Refused, match="wrong token"):
        Remote("127.0.0.1", gateway.port, lower("sesame", Tier.person)).call("ping")
    (tmp_path / "token").write_text("sesame\n")
    words = ["--token-file", str(tmp_path / "token"), "--lower", "observe"]
    token = subprocess.run([sys.executable, "-m", "lithe.gateway", *words], capture_output=True, check=True).stdout
    with Remote("127.0.0.1", gateway.port, token.decode().strip()) as watcher:
        assert watcher.call("status")["mode"] and refused(watcher.call, "arm") == "no_permission"
    with socket.create_connection(("127.0.0.1", gateway.port), 30) as link:
        link.sendall(json.dumps({"token": token.decode().strip(), "estop": True}).encode() + b"\n")
        link.makefile("rb").readline()
    assert robot.status()["mode"] == "estop", "whoever may look may stop"
    gateway.close()


@pytest.mark.parametrize(("term", "value"), FENCES)
def test_an_agent_cannot_loosen_what_judges_its_law(robot: lithe.Robot, term: str, value: float) -> None:
    gateway = Gateway(robot, token="sesame")
    gateway.start()
    before = robot.status()["law_id"]
    with (
        Remote("127.0.0.1", gateway.port, "sesame") as agent,
        pytest.raises(lithe.Refused, match=rf"{term} = {value:g} .* robot file's [0-9.]+ ") as refusal,
    ):
        agent.call("swap", source=PD, name="pd.cpp", **{term: value})
    assert refusal.value.code == "no_permission" and f"leave {term} out" in refusal.value.next
    assert robot.status()["law_id"] == before
    gateway.close()


def test_who_may_only_look_stops_a_moving_robot_and_it_is_braked(gateway: Gateway, robot: lithe.Robot) -> None:
    with (
        Remote("127.0.0.1", gateway.port, "sesame") as person,
        Remote("127.0.0.1", gateway.port, lower("sesame", Tier.observe)) as watcher,
    ):
        person.call("set_reference", kind="sine", centre_rad=0.0, amplitude_rad=1.0, frequency_hz=0.8, stay=True)
        for _ in range(2000):
            if abs(person.call("latest", fields=["velocity_rad_s"])["velocity_rad_s"][0]) > 2:
                break
        told = watcher.call("disarm")
        assert told["mode"] == "disarmed" and told["what"].startswith("braked joint shoulder from "), told
        assert "to rest, then off" in told["what"]
        person.call("arm")
        at_rest = person.call("disarm")
        assert at_rest["mode"] == "disarmed"
        person.call("stop_reference")


def test_mcp_asks_for_the_tier_that_a_person_has_given(tmp_path: Path) -> None:
    asked: list[str] = []
    server = Server(lambda verb, _: asked.append(verb) or {}, tmp_path / "may")
    answers: list[dict[str, Any]] = []

    def denied(verb: str, args: dict[str, Any]) -> bool:
        words = {"method": "tools/call", "id": 1, "jsonrpc": "2.0", "params": {"name": verb, "arguments": args}}
        server.line(json.dumps(words).encode(), answers.append)
        server.finish()
        return bool(answers[-1]["result"]["content"][0]["text"].startswith("no_permission"))

    for tier in Tier:
        if tier:
            permission.give(tmp_path / "may", 1, tier)
        for verb, args, needed in ALL:
            assert denied(verb, args) == (needed > tier), (tier, verb, args)
    assert len(asked) == sum(needed <= tier for tier in Tier for *_, needed in ALL)
