# SPDX-License-Identifier: Apache-2.0
"""Our sides of the CANopen tests: the driver as the program canopen_peer, the simulated drive as lithe-sim."""

import json
import subprocess
import threading
from pathlib import Path
from typing import Any

from system.drives.canopen_rig import wait_for
from system.robot_rig import BIN, need

NODE = 5
ROBOT = """
name = "one"
rate_hz = 200
[[bus]]
name = "can0"
kind = "slcan"
path = "/dev/null"
data_bitrate = 0
[[device]]
name = "drive"
kind = "cia402"
bus = "can0"
id = 5
counts_per_rev = 4096
rated_torque_nm = 0.5
[[joint]]
name = "joint"
device = "drive"
ratio = 10.0
position_min_rad = -3.0
position_max_rad = 3.0
velocity_max_rad_s = 20.0
torque_max_nm = 5.0
torque_slew_nm_s = 1000.0
safe_kd_nm_s_rad = 0.5
[joint.sim]
inertia_kg_m2 = 0.05
viscous_nm_s_rad = 0.01
"""


class OurDriver:
    """The program canopen_peer; the last line that it told."""

    def __init__(self, path: str, mode: str = "torque") -> None:
        """Start it."""
        need("canopen_peer")
        self.process = subprocess.Popen(
            [BIN / "canopen_peer", path, str(NODE), mode], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.now: dict[str, Any] = {}
        self.listener = threading.Thread(target=self._listen, daemon=True)
        self.listener.start()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.now = json.loads(line)

    def order(self, *words: object) -> None:
        """One line to it."""
        assert self.process.stdin is not None
        self.process.stdin.write(" ".join(map(str, words)) + "\n")
        self.process.stdin.flush()

    def until(self, seconds: float = 90.0, **wanted: object) -> dict[str, Any]:
        """Waits until it tells all this; values may be tests."""

        def holds() -> dict[str, Any] | None:
            now = self.now
            for name, value in wanted.items():
                if name not in now or not (value(now[name]) if callable(value) else now[name] == value):
                    return None
            return now

        try:
            found: dict[str, Any] = wait_for(holds, seconds)
        except AssertionError:
            raise AssertionError(f"never {wanted}; last: {self.now}") from None
        return found

    def close(self) -> None:
        """End it."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        self.process.wait(timeout=20)
        self.listener.join()
        self.process.stdout.close()


class OurDrive:
    """The program lithe-sim with one drive, and its bus under a fixed name."""

    def __init__(self, directory: Path) -> None:
        """Start it."""
        need("lithe-sim")
        (directory / "one.toml").write_text(ROBOT)
        self.process = subprocess.Popen(
            [BIN / "lithe-sim", directory / "one.toml", "--link", directory],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.path = directory / "can0"
        wait_for(lambda: self.path.exists() or self.process.poll() is not None)
        if self.process.poll() is not None:
            raise AssertionError(self.process.communicate())
        assert self.process.stdout is not None
        self.process.stdout.readline()  # where the bus is

    def order(self, order: dict[str, object]) -> None:
        """A fault, begun or ended."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps(order) + "\n")
        self.process.stdin.flush()
        assert json.loads(self.process.stdout.readline()) == {"ok": True}

    def close(self) -> None:
        """End it."""
        self.process.terminate()
        self.process.communicate(timeout=20)
        assert self.process.returncode == 0
