# SPDX-License-Identifier: Apache-2.0
"""One robot per test: the real binaries, with a run directory and a shared-memory prefix of its own."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(os.environ.get("LITHE_BIN_DIR", ROOT / "build" / "release" / "bin"))
START_S = 90.0


def need(*names: str) -> None:
    """A test without its programs has failed: one that is skipped has shown nothing, and nobody reads that."""
    for name in names:
        assert (BIN / name).exists(), f"no {name} in {BIN}: run `make`, or set LITHE_BIN_DIR"


class RobotRig:
    """Where one robot lives: its directories, its environment, the processes started for it."""

    def __init__(self) -> None:
        """Make empty directories; nothing runs yet but who clears up when the test run dies."""
        need("lithe", "lithe-spine", "lithe-spine-sim", "lawd")
        self.dir = Path(tempfile.mkdtemp(prefix="lithe-"))
        self.prefix = f"t{self.dir.name[6:]}"
        cleaner = [sys.executable, "-IS", Path(__file__).with_name("cleanup.py"), self.prefix, self.dir]
        self.cleaner = subprocess.Popen(cleaner, stdin=subprocess.PIPE, start_new_session=True)
        self.env = os.environ | {
            "LITHE_RUN_DIR": str(self.dir / "run"),
            "LITHE_SHM_PREFIX": self.prefix,
            "LITHE_OUT_DIR": str(self.dir / "out"),
        }
        self.started: list[subprocess.Popen[str]] = []
        self.wrapper: list[str] = []  # what `lithe run` is started through
        self.config = ROOT / "robots" / "arm.toml"

    def __enter__(self) -> "RobotRig":
        """It is there already."""
        return self

    def __exit__(self, *_why: object) -> None:
        """Also when a test, or a fixture, has failed."""
        self.close()

    def run(self, *words: str, wait: bool = True) -> subprocess.Popen[str]:
        """`lithe run` on the arm; waits until its socket is there."""
        log = (self.dir / f"run{len(self.started)}.log").open("w")
        process = subprocess.Popen(
            [*self.wrapper, BIN / "lithe", "run", self.config, *words], env=self.env, stdout=log, stderr=log, text=True
        )
        log.close()
        self.started.append(process)
        if wait:
            self.wait_for(lambda: self.socket.exists() or process.poll() is not None, START_S)
            assert process.poll() is None, self.log()
        return process

    @property
    def socket(self) -> Path:
        """The control socket of the arm."""
        return self.dir / "run" / "arm.sock"

    def log(self, number: int = -1) -> str:
        """What a `lithe run` has said so far."""
        return (self.dir / f"run{number % len(self.started)}.log").read_text()

    def lithe(self, *words: str | Path) -> subprocess.CompletedProcess[str]:
        """One `lithe` command to its end."""
        command = [BIN / "lithe", *words]
        return subprocess.run(command, check=False, env=self.env, capture_output=True, text=True, timeout=120)

    def ask(self, *words: str | Path, code: int = 0) -> Any:
        """One `lithe --json` command; its document."""
        done = self.lithe("--json", *words)
        assert done.returncode == code, f"{words}: exit {done.returncode}\n{done.stdout}{done.stderr}"
        return json.loads(done.stdout)

    def raw(self, payload: bytes) -> dict[str, Any]:
        """Bytes to the control socket, one line back."""
        with socket.socket(socket.AF_UNIX) as link:
            link.connect(str(self.socket))
            link.settimeout(60)
            with contextlib.suppress(OSError):  # cut off while sending: the reason can still be read
                link.sendall(payload)
            with link.makefile("rb") as lines:
                answer: dict[str, Any] = json.loads(lines.readline())
                return answer

    @staticmethod
    def wait_for(condition: Any, timeout_s: float = START_S) -> None:
        """Poll until the condition holds: the longer it takes, the more seldom, since each question costs a process."""
        start = time.monotonic()
        while not condition():
            waited_s = time.monotonic() - start
            assert waited_s < timeout_s, "waited in vain"
            time.sleep(min(max(0.02, 0.1 * waited_s), 0.2))

    def wait_for_event(self, kind: str, since: int) -> None:
        """Until the supervisor has noted such an event after this cursor, and has done what it does in that turn."""
        self.wait_for(lambda: kind in [each["kind"] for each in self.ask("events", "--since", str(since))["events"]])
        self.ask("status")  # answered in a later turn

    def segments(self) -> list[Path]:
        """What is left in shared memory, lock files aside."""
        return [each for each in Path("/dev/shm").glob(f"{self.prefix}.*") if each.suffix != ".lock"]

    def freeze(self, spine: int, robot: str = "arm") -> None:
        """Stop a Spine's process and wait until its tick stands still: on a busy machine it goes on for a while."""
        os.kill(spine, signal.SIGSTOP)
        ticks = [-1, -2]

        def still() -> bool:
            time.sleep(0.1)
            ticks[:] = ticks[1], int(self.ask("--robot", robot, "status")["tick"])
            return ticks[0] == ticks[1]

        self.wait_for(still)

    def close(self) -> None:
        """End whatever still runs and remove everything."""
        for process in self.started:
            if process.poll() is None:
                process.terminate()
        for process in self.started:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(20)
        self.cleaner.communicate()
        for process in self.started:
            process.wait()


def alive(pid: int) -> bool:
    """Whether a process is there and not a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
