# SPDX-License-Identifier: Apache-2.0
"""The TCP gateway: who gets in, what a bad request gets, and that an agent can do all that the Brain can."""

import json
import os
import random
import signal
import socket
import stat
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import lithe
import numpy as np
import pytest
from lithe.gateway import Gateway, encode
from lithe.gateway.client import MOST_REQUEST_BYTES
from lithe.gateway.parts import parts_of, simulation_of
from lithe.gateway.token import write_token
from lithe.remote import Remote
from system.robot_rig import ROOT, RobotRig
from talk import ask, lines


def test_a_file_that_is_no_token_file_is_left_as_it_is(tmp_path: Path) -> None:
    thesis = tmp_path / "thesis.txt"
    thesis.write_text("years of work")
    thesis.chmod(0o644)
    for path in (thesis, tmp_path):
        with pytest.raises(lithe.LitheError, match="is no token file"):
            write_token(path)
    assert thesis.read_text() == "years of work"


def test_the_token_file_is_for_its_owner_alone(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "token"
    first, second = write_token(path), write_token(path)
    assert first != second and path.read_text().strip() == second
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


@pytest.mark.parametrize("token", ["", " \n"])
def test_an_empty_token_is_no_token(robot: lithe.Robot, tmp_path: Path, token: str) -> None:
    with pytest.raises(lithe.LitheError, match="token is empty"):
        Gateway(robot, token=token)
    (tmp_path / "token").write_text(token)
    for given in (token, tmp_path / "token"):
        with pytest.raises(lithe.LitheError, match="empty"):
            lithe.Remote("127.0.0.1", 1, given)
    with pytest.raises(lithe.LitheError, match="cannot read the token file"):
        lithe.Remote("127.0.0.1", 1, tmp_path / "none")


def test_a_client_outlives_its_gateway(robot: lithe.Robot, tmp_path: Path) -> None:
    first = Gateway(robot, token=write_token(tmp_path / "token"))
    first.start()
    with lithe.Remote("127.0.0.1", first.port, tmp_path / "token") as remote:
        assert remote.call("describe")["robot"] == "arm"
        first.close()
        link = remote._client._idle[0]._socket
        link.shutdown(socket.SHUT_RDWR)  # as when the gateway's process ends
        with pytest.raises(lithe.NotRunning, match="no gateway"):
            remote.call("describe")
        second = Gateway(robot, port=first.port, token=write_token(tmp_path / "token"))
        second.start()
        assert remote.call("describe")["robot"] == "arm", "with the new token of the file"
        second.close()


def test_one_client_too_many_is_told_so_and_finds_a_place_later(
    robot: lithe.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lithe.gateway.MOST_CLIENTS", 2)
    gateway = Gateway(robot, token="sesame")
    gateway.start()
    clients = [Remote("127.0.0.1", gateway.port, "sesame") for _ in range(2)]
    with pytest.raises(lithe.Refused) as caught:
        Remote("127.0.0.1", gateway.port, "sesame")
    assert caught.value.code == "busy"
    assert clients[0].call("latest", fields=["tick"])
    clients.pop().close()

    def there_is_a_place() -> bool:
        try:
            clients.append(Remote("127.0.0.1", gateway.port, "sesame"))
        except lithe.Refused as refused:
            assert refused.code == "busy", refused
            return False
        return True

    RobotRig.wait_for(there_is_a_place)
    for client in clients:
        client.close()
    gateway.close()


def test_who_never_shows_a_token_is_shown_the_door(gateway: Gateway, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lithe.gateway.lobby.HELLO_S", 0.2)
    with socket.create_connection(("127.0.0.1", gateway.port), 30) as link:
        assert link.recv(100) == b""


@pytest.mark.parametrize(
    "hello", [b'{"token": "guess"}\n', b"{}\n", b"[1]\n", b"\xff\xfe\n", b"\n", b'{"token": "\xc3\xa9"}\n']
)
def test_without_the_token_nothing_is_answered_but_no(gateway: Gateway, hello: bytes) -> None:
    answers = lines(gateway, hello, b'{"id": 1, "verb": "estop"}\n')
    assert [answer["ok"] for answer in answers] == [False]
    assert gateway.robot.status()["mode"] == "active"


def test_a_wrong_token_is_one_of_our_errors(gateway: Gateway) -> None:
    with pytest.raises(lithe.Refused, match="token"):
        Remote("127.0.0.1", gateway.port, "guess")


def test_no_gateway_says_how_to_start_one() -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        with pytest.raises(lithe.NotRunning, match=r"python -m lithe\.gateway"):
            Remote("127.0.0.1", unused.getsockname()[1], "sesame", timeout_s=5)


@pytest.mark.parametrize(
    ("request_line", "code"),
    [
        (b"not json", "bad_request"),
        (b"[]", "bad_request"),
        (b'{"id": 1, "verb": "history", "args": 3}', "bad_request"),
        (b'{"id": 1, "verb": "history", "args": {"seconds": "long"}}', "bad_request"),
        (b'{"id": 1, "verb": "publish", "args": {}}', "bad_request"),
        (b'{"id": 1, "verb": "publish", "args": {"t_ns": [1, 2], "position_rad": [0]}}', "bad_request"),
        (b'{"id": 1, "verb": "publish", "args": {"t_ns": [], "position_rad": []}}', "bad_request"),
        (b'{"id": 1, "verb": "publish", "args": {"t_ns": ["soon"], "position_rad": [0]}}', "bad_request"),
        (b'{"id": 1, "verb": "history", "args": {"seconds": 1e999}}', "usage"),
        (b'{"id": 1, "verb": "history", "args": {"since_tick": [1]}}', "bad_request"),
        (b'{"id": 1, "verb": "latest", "args": {"fields": 3}}', "bad_request"),
        (b'{"id": 1, "verb": "add", "args": {"a": 1}}', "bad_request"),
        (b'{"id": ' + b"[" * 900 + b"]" * 900 + b', "verb": "fly"}', "unknown_verb"),
        (b'{"id": 1, "verb": "stumble"}', "error"),
        (b'{"id": 1, "verb": "mumble"}', "bad_request"),
        (b'{"id": 1, "verb": "publish", "args": {"t_ns": [1e400], "position_rad": [0]}}', "bad_request"),
        (b'{"id": 1, "verb": "latest", "args": {"fields": ["nonsense"]}}', "unknown_field"),
        (b'{"id": 1, "verb": "fly"}', "unknown_verb"),
        (b'{"id": 1, "verb": "call", "args": {"verb": "x"}}', "unknown_verb"),
        (b'{"id": 1, "verb": "set_params", "args": {"verb": "estop", "self": 1}}', "usage"),
        (b"[" * 100_000, "bad_request"),
        (b"\xff\xfe", "bad_request"),
    ],
    ids=lambda value: value[:60].decode(errors="replace") if isinstance(value, bytes) else value,
)
def test_a_bad_request_gets_a_reason_and_the_robot_runs_on(gateway: Gateway, request_line: bytes, code: str) -> None:
    answer = ask(gateway, request_line)
    assert answer["ok"] is False and answer["error"]["code"] == code, answer
    assert answer["error"]["message"]
    assert gateway.robot.status()["mode"] == "active"


def test_what_json_cannot_say_becomes_null() -> None:
    assert encode({"result": [1.0, float("nan"), {"x": float("inf")}]}) == b'{"result": [1.0, null, {"x": null}]}\n'


def test_an_applications_verb_may_answer_with_numpy(gateway: Gateway) -> None:
    answer = ask(gateway, b'{"id": 1, "verb": "sums"}')
    assert answer["result"] == {"angles": [0.5, None], "n": 3, "pair": [1, 2]}


def test_garbage_between_requests_harms_neither_them_nor_others(gateway: Gateway, remote: Remote) -> None:
    noise = random.Random(1)
    garbage = [noise.randbytes(noise.randrange(1, 2000)).replace(b"\n", b" ") + b"\n" for _ in range(300)]
    good = [b'{"id": %d, "verb": "add", "args": {"a": 1, "b": 1}}\n' % number for number in range(300)]
    mixed = [line for pair in zip(garbage, good, strict=True) for line in pair]
    answers = lines(gateway, b'{"token": "sesame"}\n', *mixed)[1:]
    assert [answer["error"]["code"] for answer in answers[::2]] == ["bad_request"] * 300
    assert [(answer["id"], answer["result"]) for answer in answers[1::2]] == [(number, 2) for number in range(300)]
    assert remote.call("add", a=1, b=2) == 3


def test_a_swap_holds_nobody_elses_request_up(gateway: Gateway) -> None:
    compiling, done = threading.Event(), threading.Event()

    def swap(_: dict[str, Any]) -> str:
        compiling.set()
        return "swapped" if done.wait(60) else "nobody else was served"

    gateway.verbs["swap"] = swap
    with Remote("127.0.0.1", gateway.port, "sesame") as remote, ThreadPoolExecutor(1) as pool:
        slow = pool.submit(remote.call, "swap")
        assert compiling.wait(30)
        assert remote.call("status")["robot"] == "arm"
        done.set()
        assert slow.result() == "swapped"


def test_an_endless_line_is_cut_off(gateway: Gateway) -> None:
    answer = ask(gateway, b'{"id": 1, "verb": "' + b"x" * (MOST_REQUEST_BYTES + 100))
    assert answer["error"]["code"] == "too_long"


def test_every_request_is_answered_in_turn_with_its_id(gateway: Gateway) -> None:
    requests = [json.dumps({"id": i, "verb": "add", "args": {"a": i, "b": 1}}).encode() + b"\n" for i in range(20)]
    answers = lines(gateway, b'{"token": "sesame"}\n', *requests)[1:]
    assert [(answer["id"], answer["result"]) for answer in answers] == [(i, i + 1) for i in range(20)]


def test_describe_tells_what_an_agent_must_know(remote: Remote) -> None:
    about = remote.call("describe")
    assert about["robot"] == "arm" and about["rate_hz"] == 1000.0
    assert about["joints"][0]["name"] == "shoulder" and about["joints"][0]["torque_max_nm"] == 0.6
    (joint,) = about["joints"]
    assert joint["group"] == "" and joint["drive"] == {"device": "shoulder_drive", "kind": "moteus", "bus": "can0"}
    assert {"contract", "rules", "mistakes", "swapping", "faults", "plants", "laws/pd.cpp"} <= set(about["documents"])


def test_a_robot_file_that_is_gone_or_another_one_takes_nothing_else_away(tmp_path: Path) -> None:
    drives, sensors = parts_of(ROOT / "robots/frankenstein.toml")
    assert drives["hand"]["kind"] == "moteus" and drives["column"]["kind"] == "cia402"
    assert sensors["grip_n"] == {"kind": "analog", "device": "hand_inputs"}
    assert parts_of(tmp_path / "gone.toml") == ({}, {})
    for text in ("joint = 3", "device = 3\n[[joint]]\nname = 'x'", "not toml"):
        (tmp_path / "bad.toml").write_text(text)
        assert parts_of(tmp_path / "bad.toml") == ({}, {})


def test_the_simulation_is_told_as_the_robot_file_states_it_and_nothing_more(tmp_path: Path) -> None:
    chain = simulation_of(ROOT / "robots/chain.toml")
    assert chain is not None and chain["plant"] == {"kind": "chain", "gravity_m_s2": 9.81}
    friction = {"rotor_inertia_kg_m2": 2.0e-3, "viscous_nm_s_rad": 2.0e-2, "coulomb_nm": 0.03}
    assert chain["joints"]["wrist"] == {**friction, "length_m": 0.12, "mass_kg": 0.08}
    mixed = simulation_of(ROOT / "robots/frankenstein.toml")
    assert mixed is not None and mixed["buses"]["can2"] == {"bitrate": 1_000_000, "data_bitrate": 0}
    assert mixed["joints"]["hand"]["bus_delay_s"] == 0.00025 and mixed["joints"]["hand"]["coulomb_nm"] == 0.01
    real = tmp_path / "real.toml"
    text = (ROOT / "robots/frankenstein.toml").read_text()
    real.write_text(text.replace('name = "can2"\nkind = "loop"', 'name = "can2"\nkind = "slcan"\npath = "/dev/x"'))
    partly = simulation_of(real)
    assert partly is not None and set(mixed["joints"]) - set(partly["joints"]) == {"column", "boom"}
    real.write_text(text.replace('kind = "loop"', 'kind = "slcan"'))
    assert simulation_of(real) is None and simulation_of(tmp_path / "gone.toml") is None


def test_events_without_a_cursor_are_the_newest(remote: Remote) -> None:
    remote.call("hold"), remote.call("arm")
    before = remote.call("events")["cursor"]
    newest = remote.call("events", limit=2)
    assert len(newest["events"]) == 2 and newest["cursor"] >= before
    assert len(remote.call("events", since=0, limit=1)["events"]) == 1


def test_history_goes_on_where_the_last_answer_ended(remote: Remote) -> None:
    first = remote.call("history", seconds=1.0, fields=["tick", "position_rad"])
    time.sleep(0.3)
    more = remote.call("history", seconds=4.0, since_tick=first["tick"][-1], fields=["tick"])
    assert more["tick"][0] == first["tick"][-1] + 1
    assert len(first["position_rad"][0]) == 1 and more["lost"] == 0
    RobotRig.wait_for(lambda: remote.call("history", since_tick=0, fields=["tick"])["tick"][-1] > more["tick"][-1])
    thin = remote.call("history", seconds=1.0, every=10, fields=["tick"])
    assert thin["tick"][1] - thin["tick"][0] == 10 and thin["tick"][0] % 10 == 0


def test_history_goes_on_further_back_with_fewer_ticks(remote: Remote) -> None:
    until = time.monotonic() + 60
    while "thinned" not in (past := remote.call("history", seconds=60, fields=["tick"])) and time.monotonic() < until:
        time.sleep(0.5)  # the Spine keeps 4096 ticks
    ticks, thinned = np.array(past["tick"]), past["thinned"]
    older = ticks[ticks < thinned["before_tick"]]
    assert thinned["every"] == 20 and len(older) >= 1
    assert (older % 20 == 0).all() and (np.diff(older) == 20).all()
    assert (np.diff(ticks[len(older) :]) == 1).all() and ticks[len(older)] == thinned["before_tick"]
    few = np.array(remote.call("history", seconds=60, every=40, fields=["tick"])["tick"])
    assert (np.diff(few)[:-1] == 40).sum() > len(few) - 4
    assert "thinned" not in remote.call("history", seconds=1, fields=["tick"])


def test_an_agent_publishes_swaps_and_tunes(remote: Remote) -> None:
    assert remote.call("swap", source=(ROOT / "laws/pd.cpp").read_text(), name="pd.cpp")["law"] == "pd"
    remote.call("set_params", values={"kp_nm_rad": 2.5})
    assert {entry["name"]: entry["value"] for entry in remote.call("params")["params"]}["kp_nm_rad"] == 2.5
    plan_id = remote.call("publish", t_ns=[time.monotonic_ns() + 500_000_000], position_rad=[0.1])["plan_id"]
    until = time.monotonic() + 60
    while remote.call("latest", fields=["plan_id"])["plan_id"] != plan_id and time.monotonic() < until:
        time.sleep(0.02)
    assert remote.call("latest", fields=["plan_id"])["plan_id"] == plan_id


def test_an_agent_that_pressed_the_estop_can_reset_and_arm_again(remote: Remote) -> None:
    pressed = remote.call("estop")
    assert pressed["mode"] == "estop" and remote.call("status")["mode"] == "estop"
    with pytest.raises(lithe.Refused) as caught:
        remote.call("arm")
    assert caught.value.code == "refused_estop"
    assert remote.call("reset")["mode"] == "disarmed"
    assert remote.call("arm")["mode"] == "active"


def test_a_spine_that_does_not_obey_the_estop_is_reported(remote: Remote, robot: lithe.Robot, rig: RobotRig) -> None:
    spine = int(robot.spine.mapping.header().writer_pid)
    rig.freeze(spine)
    try:
        with pytest.raises(lithe.Refused, match=r"has not obeyed[\s\S]*cut its power") as caught:
            remote.call("estop")
    finally:
        os.kill(spine, signal.SIGCONT)
    assert caught.value.code == "robot_fault"
    rig.wait_for(lambda: remote.call("status")["mode"] == "estop")
    remote.call("reset")


def test_a_compile_error_reaches_the_agent_with_its_line(remote: Remote) -> None:
    with pytest.raises(lithe.Refused) as caught:
        remote.call("swap", source="#include <lithe/law.hpp>\nint broken(\n", name="broken.cpp")
    assert "broken.cpp" in str(caught.value.detail)


def test_a_brief_answer_names_the_document_with_the_certificate(remote: Remote) -> None:
    source = (ROOT / "laws/pd.cpp").read_text()
    answer = remote.call("swap", source=source, name="pd.cpp", brief=True, wait=False)
    assert len(json.dumps(answer)) < 1000 and (answer["verdict"], answer["law"]) == ("committed", "pd")
    told = json.loads(remote.call("document", name=answer["certificate"])["text"])
    assert told["commit_tick"] == answer["commit_tick"] and told["trial"]["ok"] is True
    compared = remote.call("swap", source=source, name="pd.cpp", brief=True, shadow_s=0.1, promote=False)
    assert compared["verdict"] == "measured" and compared["shadow_most_nm"] == {"shoulder": pytest.approx(0, abs=1e-6)}
    with pytest.raises(lithe.Refused) as caught:
        remote.call("swap", source="#include <lithe/law.hpp>\nint broken(\n", name="broken.cpp", brief=True)
    assert len(json.dumps(caught.value.detail)) < 1000
    refused = json.loads(remote.call("document", name=str(caught.value.detail["certificate"]))["text"])
    assert refused["error"]["code"] == "compile_failed"
    for name in ("swaps/9999", "swaps/../../arm"):
        with pytest.raises(lithe.Refused) as caught:
            remote.call("document", name=name)
        assert caught.value.code == "unknown_document"


def test_many_agents_at_once_are_all_served(gateway: Gateway) -> None:
    def work(number: int) -> int:
        client = Remote("127.0.0.1", gateway.port, "sesame")
        for _ in range(10):
            client.call("latest", fields=["tick", "position_rad"])
            client.call("history", seconds=0.05)
        client.close()
        return number

    with ThreadPoolExecutor(8) as pool:
        assert sorted(pool.map(work, range(8))) == list(range(8))


def test_a_reference_moves_the_joint_and_rests_when_its_client_leaves(robot: lithe.Robot) -> None:
    """The gateway streams; what leaves the limits is refused, and changes nothing."""
    gateway = Gateway(robot, token="sesame")
    gateway.start()

    def wait_for(what: Callable[[Any], bool]) -> None:
        end = time.monotonic() + 60
        while not ((record := robot.telemetry.latest()) is not None and what(record)):
            assert time.monotonic() < end
            time.sleep(0.05)

    with lithe.Remote("127.0.0.1", gateway.port, "sesame") as remote:
        if remote.call("status")["mode"] != "active":
            remote.call("arm")
        for refused in ({"amplitude_rad": 9.0}, {"amplitude_rad": 0.3, "from_hz": 1}):
            with pytest.raises(lithe.Refused):
                remote.call("set_reference", kind="sine", centre_rad=0.0, frequency_hz=0.5, **refused)
        assert remote.call("reference")["streams"] is False
        asked = {"kind": "sine", "centre_rad": 0.0, "amplitude_rad": 0.3, "frequency_hz": 1.0, "client_stale_s": 60}
        told = remote.call("set_reference", **asked)
        assert told["asked"] == asked
        for sign in (1, -1):
            wait_for(lambda record, sign=sign: sign * float(record["setpoint_position_rad"][0]) > 0.25)
        assert remote.call("reference")["since_ns"] == told["since_ns"]
    wait_for(lambda _: gateway.references.told()["ended"] == "its client has left")
    wait_for(lambda record: float(record["setpoint_velocity_rad_s"][0]) == 0.0)
    assert robot.status()["mode"] == "active"
    gateway.close()


def test_a_reference_that_the_spine_does_not_follow_is_refused_or_ends_and_says_why(remote: Remote) -> None:
    asked = {"kind": "sine", "centre_rad": 0.0, "amplitude_rad": 0.3, "frequency_hz": 1.0, "client_stale_s": 60}
    remote.call("set_reference", **asked)
    remote.call("hold")
    RobotRig.wait_for(lambda: remote.call("reference")["streams"] is False)
    assert "in mode hold" in remote.call("reference")["ended"]
    for stop in ("hold", "disarm"):
        remote.call(stop)
        for kind in (asked, {"kind": "rest"}):
            with pytest.raises(lithe.Refused) as caught:
                remote.call("set_reference", **kind)
            assert caught.value.code == "refused_mode" and "arm" in caught.value.next
        assert remote.call("reference")["streams"] is False
    remote.call("arm")
    assert remote.call("set_reference", **asked)["streams"]
