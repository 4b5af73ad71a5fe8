# SPDX-License-Identifier: Apache-2.0
"""The supervisor's control socket: one JSON document a line, both ways.

Threads: a Client may be shared, each call has a connection to itself. Errors: NotRunning, Refused.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import struct
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .errors import LitheError, NoSupervisor, NotRunning, Refused
from .mailbox import ticks_alone

QUESTIONS = frozenset({"ping", "status", "events", "params", "law_list", "law_check"})  # change nothing
MOST_ANSWER_BYTES = 64 << 20
MOST_IDLE = 4  # connections kept for the next calls; the supervisor serves 64 in all
LOOK_S = 1.0


def run_dir() -> Path:
    """$LITHE_RUN_DIR, else /run/lithe (root), else $XDG_RUNTIME_DIR/lithe, else /tmp/lithe-<uid>."""
    if value := os.environ.get("LITHE_RUN_DIR"):
        return Path(value)
    if os.geteuid() == 0:
        return Path("/run/lithe")
    if value := os.environ.get("XDG_RUNTIME_DIR"):
        return Path(value) / "lithe"
    return Path(f"/tmp/lithe-{os.geteuid()}")


def _answers(path: Path) -> bool:
    """True when a process listens there. A socket file stays after a supervisor was killed."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as sock:
        sock.settimeout(LOOK_S)
        try:
            sock.connect(str(path))
        except (ConnectionRefusedError, FileNotFoundError):
            return False
        except OSError:
            return True  # busy, or not ours to open: connecting for good will say which
        return True


def _alone(robot: str) -> NoSupervisor:
    return NoSupervisor(
        f"robot '{robot}' has no supervisor, and its Spine ticks on\n"
        "  next: lithe run ROBOT.toml takes it over as it is; lithe estop stops its motion"
    )


def find_robot() -> str:
    """The one robot whose supervisor answers here; NotRunning if there is none, LitheError if there are several."""
    names = sorted(path.stem for path in run_dir().glob("*.sock") if _answers(path))
    if not names:
        raise NotRunning(f"no robot runs here (no supervisor answers in {run_dir()})\n  next: lithe run ROBOT.toml")
    if len(names) > 1:
        raise LitheError(f"several robots run here: {', '.join(names)}\n  next: lithe.connect('{names[0]}')")
    return names[0]


def _stopped_pid(sock: socket.socket) -> int:
    """The process that listens at the other end, if it is stopped (Ctrl-Z, a debugger); else 0."""
    try:
        pid = int(struct.unpack("3i", sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))[0])
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2][:1]
    except OSError:
        return 0
    return pid if state in ("T", "t") else 0


def plain(value: Any) -> Any:
    """For json.dumps: numpy's arrays and numbers as Python's own, paths as text."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"{type(value).__name__} has no JSON form")


class LineSocket:
    """Requests and answers as JSON lines over a connected stream socket. One call at a time."""

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        self._file = sock.makefile("rwb")
        self._id = 0

    def is_idle(self) -> bool:
        """True when it is open and has no unexpected input: it can be used for the next call."""
        look = select.poll()
        look.register(self._socket, select.POLLIN)
        return not look.poll(0)

    def call(self, verb: str, args: dict[str, Any]) -> Any:
        """Sends one request and returns its result. After any error but Refused this connection is of no more use."""
        self._id += 1
        try:
            request = json.dumps({"id": self._id, "verb": verb, "args": args}, default=plain, allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            raise Refused("bad_request", f"the arguments of '{verb}' have no JSON form: {error}") from None
        answer = self.exchange(request.encode(), verb)
        if answer.get("id") != self._id and not (answer.get("id") is None and answer.get("ok") is False):
            raise LitheError(f"the answer to '{verb}' belongs to another request ({answer.get('id')!r})")
        if answer.get("ok"):
            return answer.get("result")
        raise refusal_in(answer)

    def exchange(self, request: bytes, what: str) -> dict[str, Any]:
        """One line out, one object back."""
        unsure = "nothing was changed" if what in QUESTIONS else f"whether '{what}' was done is not known"
        unsure += "; the next call connects again"
        try:
            self._file.write(request + b"\n")
            self._file.flush()
            line = self._file.readline(MOST_ANSWER_BYTES)
        except OSError as error:
            raise NotRunning(f"the connection broke while asking '{what}' ({error})\n  next: {unsure}") from None
        if not line:
            raise NotRunning(f"the other side closed the connection while asking '{what}'\n  next: {unsure}")
        try:
            answer = json.loads(line)
        except (ValueError, RecursionError):
            answer = None
        if answer is None and not line.endswith(b"\n") and len(line) < MOST_ANSWER_BYTES:
            raise NotRunning(f"the connection broke in the middle of the answer to '{what}'\n  next: {unsure}")
        if not isinstance(answer, dict):
            raise LitheError(f"the answer to '{what}' is not a JSON object: is that a LITHE socket?")
        return answer

    def close(self) -> None:
        """Closes the connection; may be called twice."""
        with contextlib.suppress(OSError):  # the rest cannot be sent any more
            self._file.close()
        self._socket.close()


def refusal_in(answer: dict[str, Any]) -> Refused:
    """The error of an answer that is not ok; any contents are safe."""
    refusal = answer.get("error")
    if not isinstance(refusal, dict):
        refusal = {}
    return Refused(
        str(refusal.get("code", "error")),
        str(refusal.get("message", "refused")),
        str(refusal.get("next", "")),
        refusal.get("detail") or refusal,
    )


class Client:
    """Calls over connections that `connect` opens: each call has one to itself, and leaves it to the next.

    So a swap that compiles does not hold up another thread's status. A connection whose other side went away is noticed
    before anything is sent over it, and replaced: after a restart the next call simply works. No request is sent twice.
    """

    def __init__(self, connect: Callable[[], LineSocket], may_be_absent: bool = False) -> None:
        self._connect = connect
        self._lock = threading.Lock()
        self._idle: list[LineSocket] = []
        self._closed = False
        try:
            self._idle.append(connect())
        except NoSupervisor:
            if not may_be_absent:
                raise

    def call(self, verb: str, args: dict[str, Any]) -> Any:
        """Sends one request and returns its result."""
        link = self._take()
        try:
            result = link.call(verb, args)
        except Refused:
            self._give_back(link)
            raise
        except BaseException:  # a late answer must not be taken for the next call's
            link.close()
            raise
        self._give_back(link)
        return result

    def _take(self) -> LineSocket:
        while True:
            with self._lock:
                if self._closed:
                    raise LitheError("this connection was closed\n  next: connect again")
                link = self._idle.pop() if self._idle else None
            if link is None:
                return self._connect()
            if link.is_idle():
                return link
            link.close()

    def _give_back(self, link: LineSocket) -> None:
        with self._lock:
            if not self._closed and len(self._idle) < MOST_IDLE:
                self._idle.append(link)
                return
        link.close()

    def close(self) -> None:
        """Closes the connections; pending calls still get their answers."""
        with self._lock:
            self._closed = True
            idle, self._idle = self._idle, []
        for link in idle:
            link.close()


def _open(robot: str, timeout_s: float) -> LineSocket:
    path = run_dir() / f"{robot}.sock"
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    sock.settimeout(timeout_s)
    try:
        sock.connect(str(path))
    except PermissionError:
        sock.close()
        raise NotRunning(f"no right to open {path}\n  next: join the group of that file, or run as its owner") from None
    except OSError as error:
        sock.close()
        absent = isinstance(error, ConnectionRefusedError | FileNotFoundError)
        if absent and ticks_alone(robot):
            raise _alone(robot) from None
        raise (NoSupervisor if absent else NotRunning)(
            f"robot '{robot}' does not answer at {path} ({error.strerror or error})\n  next: lithe run ROBOT.toml"
        ) from None
    if pid := _stopped_pid(sock):
        sock.close()
        raise NotRunning(
            f"the supervisor of '{robot}' (pid {pid}) is stopped (Ctrl-Z?), and nothing was asked of it\n"
            f"  next: kill -CONT {pid}, or fg in its shell; lithe estop works without it"
        )
    return LineSocket(sock)


def connect_control(robot: str, timeout_s: float = 60.0, may_be_absent: bool = False) -> Client:
    """Connects to the supervisor of `robot`; an answer may take up to `timeout_s`.

    may_be_absent: while nobody listens there, calls raise NoSupervisor, and the first one after a start finds it.
    """
    return Client(lambda: _open(robot, timeout_s), may_be_absent)
