# SPDX-License-Identifier: Apache-2.0
"""Several clients of one gateway: who may move the robot, what became of a plan, and back to a law by its name."""

import dataclasses
import json
import socket
import time
from collections.abc import Iterator

import lithe
import pytest
from lithe.errors import Refused
from lithe.gateway import Gateway
from lithe.gateway.lease import Lease
from lithe.remote import Remote
from system.robot_rig import ROOT, RobotRig


@pytest.fixture
def other(gateway: Gateway) -> Iterator[Remote]:
    client = Remote("127.0.0.1", gateway.port, "sesame")
    yield client
    client.close()


def soon(remote: Remote, in_s: float = 0.4, rad: float = 0.1) -> dict[str, object]:
    """A plan of one waypoint."""
    at_ns = remote.call("describe")["now_ns"] + int(in_s * 1e9)
    return {"t_ns": [at_ns], "position_rad": [[rad]], "streaming": False}


def test_one_moves_and_the_others_read_until_it_gives_the_right_back(remote: Remote, other: Remote) -> None:
    assert remote.call("lease") == {"holder": None, "yours": False, "left_s": 0.0}
    assert other.call("publish", **soon(other))["accepted"], "without a lease everybody moves it"
    assert remote.call("lease", take=True, seconds=60)["yours"]
    told = other.call("lease")
    assert not told["yours"] and told["holder"].startswith("client 127.0.0.1:") and 0 < told["left_s"] <= 60
    for verb, args in (("publish", soon(other)), ("lease", {"take": True}), ("set_reference", {"kind": "rest"})):
        with pytest.raises(Refused) as refusal:
            other.call(verb, **args)
        assert refusal.value.code == "leased" and "127.0.0.1" in refusal.value.message
    assert other.call("status")["mode"] == "active"
    other.call("hold")  # never needs it
    remote.call("arm")
    other.call("lease", take=False)  # what it does not have, it cannot give back
    assert remote.call("lease")["yours"]
    remote.call("lease", take=False)
    assert other.call("publish", **soon(other))["accepted"]


def test_a_lease_ends_with_its_client(remote: Remote, other: Remote) -> None:
    remote.call("lease", take=True, seconds=600)
    remote.close()
    RobotRig.wait_for(lambda: other.call("lease")["holder"] is None)
    other.call("publish", **soon(other))


def hello(gateway: Gateway, client: str) -> socket.socket:
    """A connection of the client with that secret."""
    link = socket.create_connection(("127.0.0.1", gateway.port), 30)
    link.sendall(json.dumps({"token": "sesame", "client": client}).encode() + b"\n")
    assert json.loads(link.recv(100)) == {"ok": True}
    return link


def ask(link: socket.socket, verb: str, **args: object) -> dict[str, object]:
    """One request over it."""
    link.sendall(json.dumps({"id": 1, "verb": verb, "args": args}).encode() + b"\n")
    with link.makefile("rb") as file:
        answer: dict[str, object] = json.loads(file.readline())
    return answer


def test_a_client_that_names_itself_keeps_its_lease_over_a_connection_that_broke(
    gateway: Gateway, remote: Remote
) -> None:
    secret = "0123456789abcdef"
    ghost = hello(gateway, secret)
    assert ask(ghost, "lease", take=True, seconds=60)["ok"]
    again = hello(gateway, secret)  # while its first connection is still open at this end, as after a cable was pulled
    assert ask(again, "publish", **soon(remote))["ok"]
    for link in (ghost, again):
        with pytest.raises(Refused, match="has the right to move"):
            remote.call("publish", **soon(remote))
        link.close()
    RobotRig.wait_for(lambda: remote.call("lease")["left_s"] <= 10.0)
    third = hello(gateway, secret)
    assert ask(third, "lease", take=True, seconds=60)["ok"]
    for other in ("0123456789abcdeF", "short", 7):
        link = hello(gateway, other)  # type: ignore[arg-type]
        assert not ask(link, "publish", **soon(remote))["ok"]
        link.close()
    assert secret not in str(remote.call("lease"))
    assert ask(third, "lease", take=False)["ok"]
    third.close()


def test_a_lease_ends_by_itself_and_lasts_while_its_client_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    lease, me, other = Lease(), object(), object()
    lease.take(me, "me", 10)
    now_s[0] += 9
    lease.moves(me)
    now_s[0] += 9
    with pytest.raises(Refused, match="me has the right to move this robot for another 1.0 s"):
        lease.moves(other)
    now_s[0] += 2
    lease.moves(other)
    assert lease.take(other, "other")["yours"]
    for seconds in (0, -1, 601, float("nan")):
        with pytest.raises(Refused, match="seconds"):
            lease.take(other, "other", seconds)


def decided(remote: Remote, robot: lithe.Robot, **plan: float) -> bool | None:
    """What the Spine says of this plan: at once, or when a busy machine has let it tick."""
    said = remote.call("publish", **soon(remote, **plan))
    return bool(said["accepted"]) or robot.decided(said["plan_id"], wait_s=60)


def test_publish_says_what_the_spine_decided(remote: Remote, robot: lithe.Robot) -> None:
    assert decided(remote, robot, in_s=5) is True
    for _ in range(5):  # at once: each has an answer of its own
        with pytest.raises(Refused) as refusal:
            decided(remote, robot, rad=100.0)
        assert refusal.value.code == "refused_plan" and "shoulder" in refusal.value.message, refusal.value.message
    remote.call("disarm")
    RobotRig.wait_for(lambda: robot.status()["mode"] == "disarmed")  # it brakes first
    with pytest.raises(Refused) as refusal:
        decided(remote, robot)
    assert refusal.value.code == "refused_mode" and "disarmed" in refusal.value.message
    remote.call("estop")
    with pytest.raises(Refused) as refusal:
        decided(remote, robot)
    assert "reset, then arm" in refusal.value.next
    remote.call("reset")
    remote.call("arm")


def test_a_reference_that_the_spine_refuses_ends_and_says_so(
    remote: Remote, gateway: Gateway, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The gateway's own limits are wider than the Spine's: every plan passes its check."""
    kept = gateway.references
    limits = kept.limits()
    wide = dataclasses.replace(limits, least_rad=limits.least_rad - 50, most_rad=limits.most_rad + 50)
    monkeypatch.setattr(kept, "limits", lambda: wide)
    leaves = {"kind": "waypoints", "t_s": [0, 1, 3], "position_rad": [[0], [0], [limits.most_rad[0] + 2]]}
    assert remote.call("set_reference", **leaves, stay=True)["streams"]
    RobotRig.wait_for(lambda: remote.call("reference")["asked"]["kind"] == "rest")
    assert "position_limit at joint shoulder" in remote.call("reference")["ended"]


def test_a_law_that_ran_before_runs_again_by_its_name(remote: Remote, robot: lithe.Robot) -> None:
    first = str(robot.status()["law"])
    for law in ("gravity_pd", "hold"):
        robot.swap(ROOT / f"laws/{law}.cpp", probation_s=0)
    assert robot.activate("hold")["law"] == "hold", "it runs already"
    with pytest.raises(Refused) as refusal:
        remote.call("activate", law="nobody")
    assert refusal.value.code == "unknown_law" and "'gravity_pd'" in refusal.value.next
    assert remote.call("activate", law=first)["law"] == first
    with pytest.raises(Refused, match="no longer loaded") as refusal:
        robot.activate("hold")  # a step back passed over it
    kept = refusal.value.detail["source"]
    assert kept in refusal.value.next, refusal.value.next
    text = remote.call("document", name=kept)
    assert text["type"] == "text/x-c++src" and text["text"] == (ROOT / "laws/hold.cpp").read_text()
    assert remote.call("swap", source=text["text"], name="hold.cpp", probation_s=0)["law"] == "hold"
    with pytest.raises(Refused, match=r"law = \[3\]"):
        robot.call("activate", law=[3])


def test_of_two_laws_with_one_name_the_number_says_which_runs_again(remote: Remote, robot: lithe.Robot) -> None:
    text = (ROOT / "laws/hold.cpp").read_text()
    first, second = (
        remote.call("swap", source=f"{text}// {number}\n", name="hold.cpp", probation_s=0)["law_id"]
        for number in (1, 2)
    )
    assert remote.call("activate", law="hold")["law_id"] == second, "by name, the one that runs"
    assert remote.call("activate", law=first)["law_id"] == first
    with pytest.raises(Refused, match=f"no law {second} ran before this one"):
        remote.call("activate", law=second)
