# SPDX-License-Identifier: Apache-2.0
"""Starts and stops the processes of the experiment, each in an environment of its own."""

from __future__ import annotations

import contextlib
import os
import re
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lithe.control import connect_control
from lithe.errors import LitheError
from lithe.place import THREAD_VARIABLES
from lithe.programs import binary
from lithe.remote import Remote
from lithe.shm import SpineView

# Should the demo itself be killed, nothing of it stays behind: the robot stops in order, a frozen Brain goes too.
LEAVE_WITH_US = ("setpriv", "--pdeathsig", "TERM")
ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
DIE_WITH_US = ("setpriv", "--pdeathsig", "KILL")


class Disturbed(LitheError):
    """The robot stopped itself or a part of it, because something was late. evidence.py tells whose fault that was."""

    def __init__(self, fault: str) -> None:
        super().__init__(f"the robot stopped itself ({fault}): something was late for too long")
        self.fault = fault


# Faults that a machine can bring about, if the evidence says that it did; others are the robot's.
DISTURBANCES = ("sample_stale", "deadline_missed", "drive_watchdog")


def raise_unless_active(mode: str, fault: str) -> None:
    """Tells what the machine may have done to the robot from what must not happen.

    A fault in mode `active` has stopped a group of joints, and the others go on: no experiment on that robot either.
    """
    if mode in ("active", "safe_stop") and fault in DISTURBANCES:
        raise Disturbed(fault)
    if mode == "active" and fault != "none":
        raise LitheError(f"a group of the robot's joints has stopped (fault '{fault}'), the others go on")
    if mode != "active":
        raise LitheError(f"the robot left mode 'active': it is in '{mode}', fault '{fault}'")


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Stopping a robot is not broken off: neither by a second Ctrl-C nor by SIGTERM nor by a terminal's end."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, signal.SIG_IGN) for number in ENDINGS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class Stage:
    """A robot under `lithe run`, with sockets and shared memory of its own so that nothing else is in the way."""

    def __init__(self, robot_file: Path, log: Path) -> None:
        self.log_path = log
        self.robot = ""
        self._children: list[subprocess.Popen[bytes]] = []
        with contextlib.ExitStack() as ends:  # whatever fails below, all that came before it is taken back
            self._log = ends.enter_context(log.open("a", encoding="utf-8"))
            self.folder = Path(ends.enter_context(tempfile.TemporaryDirectory(prefix="lithe-demo-")))
            self.prefix = f"lithe-demo-{os.getpid()}"
            os.environ["LITHE_RUN_DIR"] = str(self.folder)
            os.environ["LITHE_SHM_PREFIX"] = self.prefix
            os.environ["LITHE_OUT_DIR"] = str(log.parent.resolve())
            ends.callback(self._remove_segments)
            self._run = subprocess.Popen(
                [*LEAVE_WITH_US, str(binary("lithe")), "run", str(robot_file)],
                stdout=self._log,
                stderr=subprocess.STDOUT,
                text=True,
            )
            ends.callback(self._end_robot)
            self._wait_until_active()
            self.spine = SpineView(self.robot)
            ends.callback(os.sched_setaffinity, 0, os.sched_getaffinity(0))  # the next robot needs all cores
            self._leave_room()
            ends.callback(self._end_children)
            self._ends = ends.pop_all()

    def _leave_room(self) -> None:
        """Keeps this process and its children off the Spine's and the Transport's cores, if there are others."""
        cores = os.sched_getaffinity(0)
        mine = cores - {int(self.spine.info["cpu_spine"]), int(self.spine.info["cpu_transport"])}
        os.sched_setaffinity(0, mine or cores - {int(self.spine.info["cpu_spine"])} or cores)

    def __enter__(self) -> Stage:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def check(self) -> None:
        """Raises when the robot has ended."""
        if self._run.poll() is not None:
            raise LitheError(f"`lithe run` ended with code {self._run.returncode}:{self.tail()}")

    def tail(self) -> str:
        """The end of the log, for an error message: without what a robot says that is well, where there is more."""
        lines = self.log_path.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        telling = [line for line in lines if " info " not in line] or lines
        return "\n  ".join(["", *telling[-8:], f"next: all of it is in {self.log_path}"])

    def _wait_until_active(self) -> None:
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            self.check()
            for path in self.folder.glob("*.sock"):
                try:
                    control = connect_control(path.stem, timeout_s=10)
                    status = control.call("status", {})
                    control.close()
                except LitheError:
                    continue
                if status["mode"] not in ("disarmed", "hold"):
                    raise_unless_active(status["mode"], status["fault"])
                    self.robot = path.stem
                    return
            time.sleep(0.1)
        raise LitheError(f"the robot did not get ready within 60 s:{self.tail()}")

    def start(self, module: str, *arguments: str) -> subprocess.Popen[bytes]:
        """Starts `python -m module` on the Brain's core; its stdout is for next_line()."""
        environment = {**os.environ, "LITHE_BRAIN_CPU": str(int(self.spine.info["cpu_brain"])), "PYTHONUNBUFFERED": "1"}
        environment.update(dict.fromkeys(THREAD_VARIABLES, "1"))
        child = subprocess.Popen(
            [*DIE_WITH_US, sys.executable, "-m", module, *arguments],
            bufsize=0,
            stdout=subprocess.PIPE,
            stderr=self._log,
            env=environment,
        )
        self._children.append(child)
        return child

    def close(self) -> None:
        """Ends everything this stage started, the robot last and gently."""
        with undisturbed():
            self._ends.close()

    def _end_children(self) -> None:
        for child in self._children:
            if child.poll() is None:
                child.send_signal(signal.SIGCONT)
                child.kill()
            child.wait()

    def _end_robot(self) -> None:
        if self._run.poll() is not None:
            return
        self._run.send_signal(signal.SIGINT)
        try:
            self._run.wait(15)
        except subprocess.TimeoutExpired:
            self._run.kill()
            self._run.wait()
            for path in Path("/dev/shm").glob(f"{self.prefix}.*.spine"):
                spine = SpineView(path.name.removeprefix(f"{self.prefix}.").removesuffix(".spine"))
                os.kill(int(spine.mapping.header().writer_pid), signal.SIGTERM)  # drives off; it outlives its parent

    def _remove_segments(self) -> None:
        for path in Path("/dev/shm").glob(f"{self.prefix}.*"):
            path.unlink(missing_ok=True)


def start_brain(stage: Stage, token_file: Path, reference: dict[str, Any]) -> tuple[subprocess.Popen[bytes], int]:
    """The Brain process, a gateway that streams this reference ({}: rest), and the gateway's port."""
    brain = stage.start(
        "lithe.gateway", "--robot", stage.robot, "--port", "0", "--tier", "person", "--token-file", str(token_file)
    )
    try:
        port = port_of(brain, 60.0)
    except LitheError as error:
        raise LitheError(f"{error}{stage.tail()}") from None
    asked = {name: value for name, value in reference.items() if name != "since_ns"} or {"kind": "rest"}
    with Remote("127.0.0.1", port, token_file) as remote:
        remote.call("set_reference", **asked, stay=True)
    return brain, port


def port_of(gateway: subprocess.Popen[bytes], timeout_s: float) -> int:
    """The port of a gateway that was just started. LitheError: it has ended, or is not ready in time."""
    assert gateway.stdout is not None
    with gateway.stdout:
        said = (next_line(gateway, timeout_s) or b"").decode(errors="replace")
    if not (found := re.match(r"robot .*:(\d+), token in ", said)):
        raise LitheError(f"the Brain did not get ready: {said.strip()}")
    return int(found[1])


def next_line(child: subprocess.Popen[bytes], timeout_s: float) -> bytes | None:
    """The next line of a child with an unbuffered pipe; None when none came in time, b"" at the end."""
    assert child.stdout is not None
    ready, _, _ = select.select([child.stdout], [], [], timeout_s)
    return child.stdout.readline() if ready else None
