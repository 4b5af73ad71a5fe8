# SPDX-License-Identifier: Apache-2.0
"""Swaps as the tests ask for them, and the certificates that they leave."""

import hashlib
import json
import os
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from calm import connected
from system.robot_rig import ROOT, START_S, RobotRig


def folder(rig: RobotRig) -> Path:
    """Where the certificates are."""
    return rig.dir / "out" / "arm" / "swaps"


def certificates(rig: RobotRig) -> list[dict[str, Any]]:
    """All of them, oldest first."""
    return [json.loads(path.read_text()) for path in sorted(folder(rig).glob("*.json"))]


def certificate(rig: RobotRig, request_id: int) -> dict[str, Any]:
    """One of them."""
    return next(each for each in certificates(rig) if each["request_id"] == request_id)


def becomes(rig: RobotRig, request_id: int, done: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Waits until a certificate says so; the certificate."""
    rig.wait_for(lambda: done(certificate(rig, request_id)))
    return certificate(rig, request_id)


def law(rig: RobotRig) -> str:
    """What runs."""
    return str(rig.ask("status")["law"])


def assert_chained(rig: RobotRig) -> None:
    """The chain, read by other eyes than the ones that wrote it."""
    lines = (folder(rig) / "chain.jsonl").read_bytes().splitlines()
    before, last = "", {}
    for line in lines:
        entry = json.loads(line)
        assert entry["previous"] == before
        before = hashlib.sha256(line).hexdigest()
        last[entry["file"]] = entry["sha256"]
    files = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder(rig).glob("*.json")}
    assert files == last


def sway(rig: RobotRig, seconds: float = 2.0) -> None:
    """Move for so long, and until nothing is on probation: on a busy machine, many ticks of motion do not count."""
    os.environ.update({key: value for key, value in rig.env.items() if key.startswith("LITHE_")})
    until = time.monotonic() + START_S
    with connected() as robot:
        while True:
            for side in (0.3, -0.3, 0.0):
                robot.go_to([side], seconds / 3)  # the arm has one joint
                time.sleep(seconds / 3)
            if robot.status()["probation"]["of"] == "none":
                return
            assert time.monotonic() < until, f"still on probation after {START_S} s of motion"


class Asks:
    """Requests in a thread of their own; their answers later."""

    def __init__(self, rig: RobotRig, requests: list[dict[str, Any]]) -> None:
        """Send them all at once, over one connection."""
        self.answers: list[dict[str, Any]] = []
        self.link = socket.socket(socket.AF_UNIX)
        self.link.connect(str(rig.socket))
        self.link.settimeout(300)
        self.link.sendall(b"".join(json.dumps({"id": i, **each}).encode() + b"\n" for i, each in enumerate(requests)))
        self.thread = threading.Thread(target=self._read, args=(len(requests),))
        self.thread.start()

    def _read(self, count: int) -> None:
        with self.link.makefile("rb") as lines:
            for _ in range(count):
                if line := lines.readline():
                    self.answers.append(json.loads(line))

    def leave(self) -> None:
        """Hangs up without waiting for any answer."""
        self.link.shutdown(socket.SHUT_RDWR)
        self.link.close()

    def wait(self) -> list[dict[str, Any]]:
        """All answers."""
        self.thread.join(300)
        self.link.close()
        return self.answers


def swap_request(name: str, **args: Any) -> dict[str, Any]:
    """One of the laws that come with LITHE."""
    return {"verb": "swap", "args": {"source": (ROOT / f"laws/{name}.cpp").read_text(), "name": f"{name}.cpp", **args}}
