# SPDX-License-Identifier: Apache-2.0
"""Starts and stops the processes of the experiment, each in an environment of its own."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from lithe.control import connect_control
from lithe.errors import LitheError
from lithe.place import THREAD_VARIABLES
from lithe.shm import SpineView

ROOT = Path(__file__).resolve().parents[3]
# Should the demo itself be killed, nothing of it stays behind: the robot stops in order, a frozen Brain goes too.
LEAVE_WITH_US = ("setpriv", "--pdeathsig", "TERM")
DIE_WITH_US = ("setpriv", "--pdeathsig", "KILL")


def binary(name: str) -> Path:
    """$LITHE_BIN_DIR, else build/release/bin of this tree."""
    path = Path(os.environ.get("LITHE_BIN_DIR") or ROOT / "build/release/bin") / name
    if not path.exists():
        raise LitheError(f"{path} is not built\n  next: make release")
    return path


class Stage:
    """A robot under `lithe run`, with sockets and shared memory of its own so that nothing else is in the way."""

    def __init__(self, robot_file: Path, log: Path) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="lithe-demo-")
        self.folder = Path(self._folder.name)
        os.environ["LITHE_RUN_DIR"] = str(self.folder)
        os.environ["LITHE_SHM_PREFIX"] = f"lithe-demo-{os.getpid()}"
        os.environ["LITHE_OUT_DIR"] = str(log.parent)
        self._log = log.open("w", encoding="utf-8")
        self._children: list[subprocess.Popen[str]] = []
        self.robot = ""
        self._run = subprocess.Popen(
            [*LEAVE_WITH_US, str(binary("lithe")), "run", str(robot_file)],
            stdout=self._log,
            stderr=subprocess.STDOUT,
            text=True,
        )
        try:
            self._wait_until_active(log)
            self.spine = SpineView(self.robot)
        except BaseException:
            self.close()
            raise
        self._leave_room()

    def _leave_room(self) -> None:
        """Keeps this process and its children off the Spine's and the Transport's cores, if there are others."""
        cores = os.sched_getaffinity(0)
        mine = cores - {int(self.spine.info["cpu_spine"]), int(self.spine.info["cpu_transport"])}
        os.sched_setaffinity(0, mine or cores - {int(self.spine.info["cpu_spine"])} or cores)

    def __enter__(self) -> Stage:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _wait_until_active(self, log: Path) -> None:
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            if self._run.poll() is not None:
                tail = log.read_text(encoding="utf-8").strip().splitlines()[-8:]
                raise LitheError(f"`lithe run` ended with code {self._run.returncode}:\n  " + "\n  ".join(tail))
            for path in self.folder.glob("*.sock"):
                try:
                    control = connect_control(path.stem, timeout_s=10)
                    mode = control.call("status", {})["mode"]
                    control.close()
                except LitheError:
                    continue
                if mode == "active":
                    self.robot = path.stem
                    return
            time.sleep(0.1)
        raise LitheError("the robot did not get ready within 60 s; see " + str(log))

    def start(self, module: str, *arguments: str) -> subprocess.Popen[str]:
        """Starts `python -m module` on the Brain's core, its stdout as lines for us."""
        environment = {**os.environ, "LITHE_BRAIN_CPU": str(int(self.spine.info["cpu_brain"])), "PYTHONUNBUFFERED": "1"}
        environment.update(dict.fromkeys(THREAD_VARIABLES, "1"))
        child = subprocess.Popen(
            [*DIE_WITH_US, sys.executable, "-m", module, *arguments],
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env=environment,
        )
        self._children.append(child)
        return child

    def close(self) -> None:
        """Ends everything this stage started, the robot last and gently."""
        for child in self._children:
            if child.poll() is None:
                child.send_signal(signal.SIGCONT)
                child.kill()
            child.wait()
        if self._run.poll() is None:
            self._run.send_signal(signal.SIGINT)
            try:
                self._run.wait(15)
            except subprocess.TimeoutExpired:
                spine_pid = int(self.spine.mapping.header().writer_pid)
                self._run.kill()
                self._run.wait()
                os.kill(spine_pid, signal.SIGTERM)  # drives off; it outlives its supervisor otherwise
        self._log.close()
        for path in Path("/dev/shm").glob(os.environ["LITHE_SHM_PREFIX"] + ".*"):
            path.unlink(missing_ok=True)
        self._folder.cleanup()


def start_brain(stage: Stage, token_file: Path, reference: dict[str, Any]) -> tuple[subprocess.Popen[str], int]:
    """The Brain process and the port of its gateway."""
    brain = stage.start("lithe.demo.brain", "--token-file", str(token_file), "--reference", json.dumps(reference))
    assert brain.stdout is not None
    line = brain.stdout.readline()
    if not line:
        raise LitheError(f"the Brain ended with code {brain.wait()} before it was ready; see the log")
    return brain, int(json.loads(line)["port"])


class Lines:
    """JSON lines of a child, readable with a time limit."""

    def __init__(self, child: subprocess.Popen[str]) -> None:
        self._queue: queue.Queue[dict[str, Any] | None] = queue.Queue()
        threading.Thread(target=self._pump, args=(child,), daemon=True).start()

    def _pump(self, child: subprocess.Popen[str]) -> None:
        assert child.stdout is not None
        for line in child.stdout:
            self._queue.put(json.loads(line))
        self._queue.put(None)

    def next(self, timeout_s: float) -> dict[str, Any] | None:
        """The next line; {} when none came in time; None at the end."""
        try:
            return self._queue.get(timeout=timeout_s)
        except queue.Empty:
            return {}
