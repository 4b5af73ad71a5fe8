# SPDX-License-Identifier: Apache-2.0
"""Finding a robot, and what is said when there is none."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lithe.control import Client, LineSocket, connect_control, find_robot, run_dir
from lithe.errors import LitheError, NotRunning, Refused


@contextmanager
def listening(path: Path) -> Iterator[socket.socket]:
    """A socket somebody listens on; its file stays behind."""
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
        server.listen()
        yield server


def test_the_run_directory_follows_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("LITHE_RUN_DIR", str(tmp_path))
    assert run_dir() == tmp_path


def test_no_robot_one_robot_and_several(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("LITHE_RUN_DIR", str(tmp_path))
    with pytest.raises(NotRunning, match=r"lithe run ROBOT\.toml"):
        find_robot()
    with listening(tmp_path / "arm.sock"):
        assert find_robot() == "arm"
        with listening(tmp_path / "leg.sock"), pytest.raises(LitheError, match=r"arm, leg"):
            find_robot()
        assert (tmp_path / "leg.sock").exists(), "what a killed supervisor leaves"
        assert find_robot() == "arm"
    with pytest.raises(NotRunning, match="no supervisor answers"):
        find_robot()


def test_a_robot_that_may_not_be_commanded_is_still_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("LITHE_RUN_DIR", str(tmp_path))

    def no_right(self: socket.socket, address: str) -> None:
        raise PermissionError(13, "Permission denied")

    with listening(tmp_path / "arm.sock"):
        monkeypatch.setattr(socket.socket, "connect", no_right)
        assert find_robot() == "arm"
        with pytest.raises(NotRunning, match="join the group"):
            connect_control("arm")


def test_a_dead_socket_says_what_to_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("LITHE_RUN_DIR", str(tmp_path))
    with pytest.raises(NotRunning, match=r"does not answer[\s\S]*lithe run"):
        connect_control("arm")


def test_a_supervisor_that_is_stopped_is_not_waited_for(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("LITHE_RUN_DIR", str(tmp_path))
    path = str(tmp_path / "arm.sock")
    deaf = f"import socket, time; s = socket.socket(1); s.bind({path!r}); s.listen(); print(flush=True); time.sleep(99)"
    with subprocess.Popen([sys.executable, "-c", deaf], stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            process.send_signal(signal.SIGSTOP)
            os.waitid(os.P_PID, process.pid, os.WSTOPPED)
            with pytest.raises(NotRunning, match=rf"is stopped[\s\S]*kill -CONT {process.pid}"):
                connect_control("arm")
        finally:
            process.kill()


def test_a_question_that_is_not_answered_has_changed_nothing() -> None:
    for verb, said in (("status", "nothing was changed"), ("arm", "whether 'arm' was done is not known")):
        ours, theirs = socket.socketpair()
        ours.settimeout(0.05)
        with theirs, closing(LineSocket(ours)) as link, pytest.raises(NotRunning, match=said):
            link.call(verb, {})


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
        (b"[" * 100_000 + b"\n", LitheError),
        (b'{"id": 2, "ok": true, "result": "of another request"}\n', LitheError),
        (b'{"ok": true, "result": "of no request"}\n', LitheError),
        (b'{"id": null, "ok": false, "error": "not an object"}\n', Refused),
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


def test_arguments_without_a_json_form_are_refused_before_they_leave() -> None:
    ours, theirs = socket.socketpair()
    lines = LineSocket(ours)
    for bad in (object(), float("nan"), {1: {2}}):
        with pytest.raises(Refused) as caught:
            lines.call("publish", {"t_ns": bad})
        assert caught.value.code == "bad_request"
    assert lines.is_idle(), "nothing was sent, the connection is as good as before"
    lines.close()
    theirs.close()


def test_numpy_and_paths_may_be_arguments() -> None:
    ours, theirs = socket.socketpair()
    thread = threading.Thread(target=serve, args=(theirs, lambda request: request["args"]))
    thread.start()
    lines = LineSocket(ours)
    sent = {"a": np.arange(2.0), "b": np.float32(0.5), "c": Path("laws/pd.cpp")}
    assert lines.call("echo", sent) == {"a": [0.0, 1.0], "b": 0.5, "c": "laws/pd.cpp"}
    lines.close()
    thread.join()


def serve(link: socket.socket, result: Callable[[dict[str, Any]], Any]) -> None:
    """Answers each line until the other side leaves."""
    with suppress(OSError), link, link.makefile("rwb") as file:
        for line in file:
            request = json.loads(line)
            answer = {"id": request["id"], "ok": True, "result": result(request)}
            file.write(json.dumps(answer).encode() + b"\n")
            file.flush()


class Side:
    """The other side of a Client: each connection has a thread, and all of them can be cut."""

    def __init__(self, result: Callable[[dict[str, Any]], Any]) -> None:
        self.result = result
        self.links: list[socket.socket] = []
        self.threads: list[threading.Thread] = []

    def open(self) -> LineSocket:
        ours, theirs = socket.socketpair()
        ours.settimeout(1.0)
        self.links.append(theirs)
        thread = threading.Thread(target=serve, args=(theirs, self.result), daemon=True)
        self.threads.append(thread)
        thread.start()
        return LineSocket(ours)

    def cut(self) -> None:
        for link in self.links:
            link.shutdown(socket.SHUT_RDWR)
        for thread in self.threads:
            thread.join()


def test_a_connection_that_ended_is_replaced_by_the_next_call() -> None:
    side = Side(lambda request: request["verb"])
    client = Client(side.open)
    assert client.call("one", {}) == "one"
    side.cut()
    assert client.call("two", {}) == "two"
    assert len(side.links) == 2
    client.close()


def test_a_late_answer_is_not_taken_for_the_next_ones() -> None:
    late = threading.Event()

    def slowly(request: dict[str, Any]) -> str:
        if request["verb"] == "slow":
            late.wait(30)
        return str(request["verb"])

    side = Side(slowly)
    client = Client(side.open)
    with pytest.raises(NotRunning, match=r"'slow' was done is not known"):
        client.call("slow", {})
    late.set()
    assert client.call("quick", {}) == "quick"
    client.close()


def test_no_call_waits_for_another_threads() -> None:
    compiling, done = threading.Event(), threading.Event()

    def answer(request: dict[str, Any]) -> str:
        if request["verb"] == "swap":
            compiling.set()
            assert done.wait(30)
        return str(request["verb"])

    side = Side(answer)
    client = Client(lambda: patient(side.open()))
    results: list[Any] = []
    swap = threading.Thread(target=lambda: results.append(client.call("swap", {})))
    swap.start()
    assert compiling.wait(30)
    assert client.call("status", {}) == "status"
    done.set()
    swap.join()
    assert results == ["swap"]
    client.close()


def patient(line: LineSocket) -> LineSocket:
    """No limit of time."""
    line._socket.settimeout(None)
    return line


def test_every_thread_gets_its_own_answers_over_few_connections() -> None:
    side = Side(lambda request: request["args"]["n"])
    client = Client(lambda: patient(side.open()))
    wrong: list[int] = []

    def work(first: int) -> None:
        wrong.extend(n for n in range(first, first + 200) if client.call("echo", {"n": n}) != n)

    threads = [threading.Thread(target=work, args=(i * 1000,)) for i in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []
    assert len(client._idle) <= 4
    client.close()
    with pytest.raises(LitheError, match="closed"):
        client.call("echo", {"n": 1})
