# SPDX-License-Identifier: Apache-2.0
"""Finding a robot, and what is said when there is none."""

import json
import socket
import threading
from pathlib import Path

import pytest
from lithe.control import LineSocket, connect_control, find_robot, run_dir
from lithe.errors import LitheError, NotRunning, Refused


def test_the_run_directory_follows_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("LITHE_RUN_DIR", str(tmp_path))
    assert run_dir() == tmp_path


def test_no_robot_one_robot_and_several(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("LITHE_RUN_DIR", str(tmp_path))
    with pytest.raises(NotRunning, match=r"lithe run ROBOT\.toml"):
        find_robot()
    (tmp_path / "arm.sock").touch()
    assert find_robot() == "arm"
    (tmp_path / "leg.sock").touch()
    with pytest.raises(LitheError, match=r"arm, leg"):
        find_robot()


def test_a_dead_socket_says_what_to_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("LITHE_RUN_DIR", str(tmp_path))
    with pytest.raises(NotRunning, match=r"does not answer[\s\S]*lithe run"):
        connect_control("arm")


def answer_once(link: socket.socket, answer: bytes) -> None:
    link.recv(65536)
    link.sendall(answer)
    link.close()


@pytest.mark.parametrize(
    ("answer", "error"),
    [
        (b'{"ok": false, "error": {"code": "refused_estop", "message": "no", "next": "reset"}}\n', Refused),
        (b"", NotRunning),
        (b"not json\n", LitheError),
        (b"[]\n", LitheError),
    ],
)
def test_whatever_comes_back_is_one_of_our_errors(answer: bytes, error: type[LitheError]) -> None:
    ours, theirs = socket.socketpair()
    thread = threading.Thread(target=answer_once, args=(theirs, answer))
    thread.start()
    lines = LineSocket(ours)
    with pytest.raises(error):
        lines.call("arm", {})
    thread.join()
    lines.close()


def test_a_refusal_keeps_code_message_and_next() -> None:
    ours, theirs = socket.socketpair()
    text = json.dumps({"ok": False, "error": {"code": "busy", "message": "m", "next": "n", "detail": {"line": 3}}})
    thread = threading.Thread(target=answer_once, args=(theirs, text.encode() + b"\n"))
    thread.start()
    lines = LineSocket(ours)
    with pytest.raises(Refused) as caught:
        lines.call("swap", {})
    thread.join()
    lines.close()
    assert (caught.value.code, caught.value.next, caught.value.detail) == ("busy", "n", {"line": 3})
    assert str(caught.value) == "m\n  next: n"
