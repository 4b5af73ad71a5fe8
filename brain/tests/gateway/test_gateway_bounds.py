# SPDX-License-Identifier: Apache-2.0
"""What a gateway's hostile clients cannot do: keep others out, keep them waiting, take its memory or its token."""

import contextlib
import fcntl
import json
import socket
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeout
from pathlib import Path
from typing import Any

import lithe
import pytest
from lithe.gateway import MOST_CLIENTS, Gateway
from lithe.gateway.lobby import MOST_OF_ONE_ADDRESS
from lithe.gateway.turns import MOST_UNSENT_BYTES, Turns
from lithe.remote import Remote
from system.robot_rig import ROOT, RobotRig
from talk import lines


def hostile(port: int, count: int) -> list[socket.socket]:
    return [socket.create_connection(("127.0.0.1", port), 30) for _ in range(count)]


def test_who_shows_no_token_takes_nobodys_place(gateway: Gateway) -> None:
    """More of them than there are places, from the address that the client comes from; some say half a hello."""
    guests = hostile(gateway.port, MOST_CLIENTS + 8)
    try:
        for guest in guests[::2]:
            with contextlib.suppress(OSError):
                guest.sendall(b'{"token": ')
        with Remote("127.0.0.1", gateway.port, "sesame") as remote:
            assert remote.call("describe")["robot"] == "arm"
            assert remote.call("estop")["mode"] == "estop"
            remote.call("reset")
            remote.call("arm")
    finally:
        for guest in guests:
            guest.close()


def test_the_one_that_has_waited_longest_goes_when_too_many_wait(gateway: Gateway) -> None:
    guests = hostile(gateway.port, MOST_OF_ONE_ADDRESS)
    late = hostile(gateway.port, 1)
    try:
        assert guests[0].recv(1) == b"", "long before its time is over, or then"
        late[0].sendall(b'{"token": "sesame"}\n')
        assert late[0].recv(100) == b'{"ok": true}\n'
    finally:
        for guest in guests + late:
            guest.close()


def test_an_estop_goes_ahead_of_what_the_same_client_asked_before(gateway: Gateway) -> None:
    asked, done = threading.Event(), threading.Event()

    def swap(_: dict[str, Any]) -> str:
        asked.set()
        return "swapped" if done.wait(60) else "the e-stop waited"

    gateway.verbs["swap"] = swap
    with socket.create_connection(("127.0.0.1", gateway.port), 90) as link, link.makefile("rb") as file:
        link.sendall(b'{"token": "sesame"}\n{"id": 1, "verb": "swap"}\n')
        assert json.loads(file.readline())["ok"] and asked.wait(30)
        link.sendall(b'{"id": 2, "verb": "status"}\n{"id": 3, "verb": "estop"}\n')
        first = json.loads(file.readline())
        done.set()
        rest = [json.loads(file.readline()) for _ in range(2)]
    assert (first["id"], first["result"]["mode"]) == (3, "estop")
    assert rest[0] == {"id": 1, "ok": True, "result": "swapped"} and rest[1]["id"] == 2
    gateway.robot.reset()
    gateway.robot.arm()


def test_an_estop_needs_no_place(robot: lithe.Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lithe.gateway.MOST_CLIENTS", 1)
    gateway = Gateway(robot, token="sesame")
    gateway.start()
    with Remote("127.0.0.1", gateway.port, "sesame") as only:
        only.call("describe")
        with pytest.raises(lithe.Refused, match="an e-stop needs no place"):
            Remote("127.0.0.1", gateway.port, "sesame")
        stopped = lines(gateway, b'{"token": "sesame", "estop": true}\n')
        assert stopped[0]["result"]["mode"] == "estop" and robot.status()["mode"] == "estop"
        assert lines(gateway, b'{"token": "guess", "estop": true}\n')[0]["error"]["code"] == "token"
    gateway.close()
    robot.reset()
    robot.arm()


ALL = json.dumps({"id": 1, "verb": "history", "args": {"seconds": 4.0, "fields": ["joint_status", "probe", "tick"]}})


def test_who_does_not_read_is_disconnected_and_the_log_says_why(
    robot: lithe.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lithe.gateway.client.UNREAD_S", 1)
    said: list[str] = []
    gateway = Gateway(robot, {"long": lambda _: "x" * (16 << 20)}, token="sesame", say=said.append)
    gateway.start()
    links: list[socket.socket] = []
    for number in range(26):  # each is let in before the next one comes: the lobby takes 16 of one address
        (link,) = hostile(gateway.port, 1)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        link.sendall(b'{"token": "sesame"}\n')
        assert link.recv(13) == b'{"ok": true}\n'
        link.sendall(b'{"verb": "long"}\n' if number < 2 else ALL.encode() + b"\n")
        links.append(link)
    RobotRig.wait_for(lambda: len(said) >= 2)
    with Remote("127.0.0.1", gateway.port, "sesame") as remote:
        assert remote.call("history", seconds=0.5)["tick"], "others are served meanwhile"
    assert "was disconnected: it left" in said[0] and "unread for 1 s" in said[0]
    for link in links:
        link.close()
    RobotRig.wait_for(lambda: gateway.turns.unsent_bytes == 0)
    gateway.close()


def test_a_long_answer_that_is_too_long_is_refused_with_the_way_out(
    gateway: Gateway, remote: Remote, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lithe.gateway.records.MOST_LONG_BYTES", 2000)
    with pytest.raises(lithe.Refused, match="several times with since_tick") as caught:
        remote.call("history", seconds=1.0)
    assert caught.value.code == "too_long" and gateway.turns.unsent_bytes == 0
    assert remote.call("history", seconds=1.0, every=100, fields=["tick"])["tick"]


def test_history_has_the_ticks_and_the_joints_that_are_asked_for(remote: Remote) -> None:
    all_of_them = remote.call("history", seconds=1.0, fields=["tick", "position_rad"])
    last = all_of_them["tick"][len(all_of_them["tick"]) // 2]
    some = remote.call("history", seconds=4.0, until_tick=last, fields=["tick", "position_rad"], joints=["shoulder"])
    assert some["tick"][-1] == last and len(some["position_rad"][0]) == 1
    with pytest.raises(lithe.Refused, match="no joint 'sholder'") as caught:
        remote.call("history", joints=["sholder"])
    assert caught.value.code == "unknown_joint" and "did you mean 'shoulder'?" in caught.value.next


class Unfair(Turns):
    """The broken twin: long answers never wait."""

    def pause(self) -> None:
        self.pieces += 1


@pytest.mark.parametrize("fair", [True, False])
def test_a_long_answer_waits_while_a_moving_verb_is_served(
    gateway: Gateway, monkeypatch: pytest.MonkeyPatch, fair: bool
) -> None:
    monkeypatch.setattr("lithe.gateway.turns.MOST_PAUSE_S", 600.0)
    monkeypatch.setattr("lithe.gateway.records.PIECE_TICKS", 8)
    turns = gateway.turns = gateway.records.turns = Turns() if fair else Unfair()
    moving, done = threading.Event(), threading.Event()

    def hold(_: dict[str, Any]) -> int:
        moving.set()
        before = turns.pieces
        done.wait(30 if not fair else 1)
        return turns.pieces - before

    gateway.verbs["hold"] = hold
    with Remote("127.0.0.1", gateway.port, "sesame") as remote, ThreadPoolExecutor(5) as pool:
        asked = pool.submit(remote.call, "hold")
        assert moving.wait(30)
        readers = [pool.submit(remote.call, "history", seconds=1.0, fields=["tick"]) for _ in range(4)]
        if not fair:
            assert [len(reader.result()["tick"]) > 100 for reader in readers] == [True] * 4
            done.set()
        made_meanwhile = asked.result()
        assert [len(reader.result()["tick"]) > 100 for reader in readers] == [True] * 4
    assert (made_meanwhile == 0) == fair


def test_long_answers_are_made_one_at_a_time_in_turn() -> None:
    turns, inside = Turns(), threading.Lock()
    order: list[int] = []

    def read(number: int) -> None:
        with turns.long_answer():
            assert inside.acquire(blocking=False), "two at once"
            turns.pause()
            order.append(number)
            inside.release()

    with ThreadPoolExecutor(4) as pool:
        with turns.long_answer():
            jobs = []
            for number in range(4):
                jobs.append(pool.submit(read, number))
                RobotRig.wait_for(lambda count=number + 2: len(turns._waiting) == count)
            assert order == []
        for job in jobs:
            job.result()
    assert order == [0, 1, 2, 3]


def test_what_is_unsent_of_all_clients_together_is_bounded() -> None:
    turns = Turns()
    turns.keep(MOST_UNSENT_BYTES - 1)
    with ThreadPoolExecutor(1) as pool:
        second = pool.submit(turns.keep, 2)
        with pytest.raises(FutureTimeout):
            second.result(0.2)
        turns.drop(MOST_UNSENT_BYTES - 1)
        second.result()
    assert turns.unsent_bytes == 2


def gateway_process(rig: RobotRig, *words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "lithe.gateway", *words],
        env=rig.env | {"PYTHONPATH": str(ROOT / "brain")},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def test_a_gateway_that_cannot_listen_leaves_the_token_alone(rig: RobotRig, tmp_path: Path) -> None:
    token = tmp_path / "token"
    token.write_text("of another gateway\n")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        second = gateway_process(rig, "--port", port, "--token-file", str(token))
        words, _ = second.communicate(timeout=60)
    assert second.returncode == 1 and "choose another host or port" in words, words
    assert token.read_text() == "of another gateway\n"


@pytest.mark.parametrize("words", [("--port", "99999"), ("--host", "192.0.2.1")])
def test_an_address_that_nobody_can_listen_on_is_one_line_not_a_traceback(
    rig: RobotRig, words: tuple[str, ...]
) -> None:
    told, _ = (gateway := gateway_process(rig, *words)).communicate(timeout=60)
    assert gateway.returncode == 1 and len(told.splitlines()) == 1 and "choose another host or port" in told, told


def test_a_token_file_that_a_gateway_serves_with_is_not_overwritten(rig: RobotRig, tmp_path: Path) -> None:
    token = tmp_path / "token"
    with token.open("w") as other:
        other.write("of another gateway\n")
        other.flush()
        fcntl.flock(other, fcntl.LOCK_EX)
        process = gateway_process(rig, "--port", "0", "--token-file", str(token))
        words, _ = process.communicate(timeout=60)
        assert process.returncode == 1 and "--token-file with another name" in words, words
        assert token.read_text() == "of another gateway\n"


def test_more_names_than_there_are_hold_nobody_up(gateway: Gateway) -> None:
    with Remote("127.0.0.1", gateway.port, "sesame") as remote:
        for verb, what, name in (
            ("history", "fields", "tick"),
            ("latest", "fields", "tick"),
            ("history", "joints", "shoulder"),
        ):
            with pytest.raises(
                lithe.Refused, match=rf"60000 {what}; there are \d+\n.*name each of them once"
            ) as refused:
                remote.call(verb, **{what: [name] * 60_000})
            assert refused.value.code == "too_many"
        assert remote.call("history", fields=["tick"])["tick"]


def test_what_cannot_be_is_refused_and_not_bent(gateway: Gateway) -> None:
    with Remote("127.0.0.1", gateway.port, "sesame") as remote:
        for verb, args, told in (
            ("measure", {"seconds": 100}, "at most 60"),
            ("history", {"seconds": -1}, "above 0"),
            ("incident", {"id": -1}, "'-1' is no number of an incident"),
        ):
            with pytest.raises(lithe.Refused, match=told):
                remote.call(verb, **args)
        none = remote.call("events", kind="nonsense")
        assert none["events"] == [] and none["next"].startswith("no event has the kind nonsense; there are:")
        assert "armed" in none["next"]
