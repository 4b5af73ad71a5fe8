# SPDX-License-Identifier: Apache-2.0
"""`lithe sim` for a test: simulated devices on terminals of its own, and orders for faults."""

import json
import subprocess
import time
from pathlib import Path
from typing import Any

from system.house import BIN, need


class Simulated:
    """The devices of a robot file, served until close()."""

    def __init__(self, robot: Path, folder: Path, *words: str, orders: bool = True) -> None:
        """Starts `lithe sim`; `folder` gets a link for each bus. Without `orders` its standard input has ended."""
        need("lithe", "lithe-sim")
        self.folder = folder
        self.process = subprocess.Popen(
            [BIN / "lithe", "sim", robot, "--link", folder, *words],
            stdin=subprocess.PIPE if orders else subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.lines: list[str] = []

    def line(self) -> str:
        """The next line it prints."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline().rstrip("\n")
        if not line:
            self.process.kill()
            raise AssertionError(f"lithe sim ended: {self.process.communicate()[1]}")
        return line

    def path(self, bus: str = "can0") -> Path:
        """Where that bus is, by its link; waits until it is."""
        end = time.monotonic() + 30
        while not (self.folder / bus).exists():
            assert self.process.poll() is None, self.process.communicate()[1]
            assert time.monotonic() < end, "no link to the bus"
            time.sleep(0.01)
        return self.folder / bus

    def order(self, **words: Any) -> dict[str, Any]:
        """One order on its standard input; its answer."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(words) + "\n")
        self.process.stdin.flush()
        while not (line := self.line()).startswith("{"):
            self.lines.append(line)
        answer: dict[str, Any] = json.loads(line)
        return answer

    def close(self) -> int:
        """Ends it as Ctrl-C would; its exit code. One that does not end is ended."""
        self.process.terminate()
        try:
            self.process.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()
        return self.process.returncode
