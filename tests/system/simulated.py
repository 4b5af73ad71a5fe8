# SPDX-License-Identifier: Apache-2.0
"""`lithe sim` for a test: simulated devices on terminals of its own, and orders for faults; robots that drive them."""

import contextlib
import json
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import calm
import lithe
import pytest
from calm import connected
from system.robot_rig import BIN, RobotRig, need

REFUSED = 2  # exit code of `lithe run` on a file that it does not take
PATIENT = "lost_after_misses = 2000\n"  # a simulated device is a process among others here
HEAVY = "inertia_max_kg_m2 = 1.3e-2\ninertia_min_kg_m2 = 8.0e-3"  # what simulated.at_terminals makes of light joints
BUSES = {"can0": "fdcanusb", "can1": "fdcanusb", "can2": "slcan"}  # of frankenstein, at the ends of terminals


class Simulated:
    """The devices of a robot file, served until close(), the end of `with`, or the end of this process."""

    def __init__(self, robot: Path, folder: Path, *words: str, orders: bool = True) -> None:
        """Starts `lithe sim`; `folder` gets a link for each bus. Without `orders` its standard input has ended."""
        need("lithe", "lithe-sim")
        self.folder = folder
        self.process = subprocess.Popen(
            ["setpriv", "--pdeathsig", "TERM", BIN / "lithe", "sim", robot, "--link", folder, *words],
            stdin=subprocess.PIPE if orders else subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.lines: list[str] = []

    def __enter__(self) -> "Simulated":
        """It serves already."""
        return self

    def __exit__(self, *_why: object) -> None:
        """Also when the test has failed."""
        self.close()

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
        """Ends it as Ctrl-C would; its exit code. One that does not end is killed. A second call changes nothing."""
        if self.process.returncode is not None:
            return self.process.returncode
        self.process.terminate()
        try:
            self.process.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()
        return self.process.returncode


@contextlib.contextmanager
def at_terminals(folder: Path) -> Iterator[tuple[str, Simulated]]:
    """Frankenstein's file with its buses at the terminals of a `lithe sim`, and that."""
    terminals = {
        f'name = "{bus}"\nkind = "loop"': f'name = "{bus}"\npath = "{folder / "buses" / bus}"\nkind = "{kind}"'
        for bus, kind in BUSES.items()
    }
    slower = {  # ticks that a busy machine keeps up with, and joints that bear such ticks under the usual law
        "rate_hz = 1000": "rate_hz = 250",
        "inertia_kg_m2 = 6.0e-4": "inertia_kg_m2 = 1.0e-2",
        "inertia_kg_m2 = 2.55e-3": "inertia_kg_m2 = 1.0e-2",
        "inertia_max_kg_m2 = 7.5e-4\ninertia_min_kg_m2 = 4.8e-4": HEAVY,
        "inertia_max_kg_m2 = 3.2e-3\ninertia_min_kg_m2 = 2.0e-3": HEAVY,
        "safe_kd_nm_s_rad = 0.04": "safe_kd_nm_s_rad = 0.1",  # of wrist and hand: their torque comes four times as late
        "[defaults.device]": f"[guard]\n{PATIENT}\n[defaults.device]",
    }
    text = calm.calm_text({**terminals, **slower}, robot="frankenstein")
    (folder / "served.toml").write_text(text, encoding="utf-8")
    with Simulated(folder / "served.toml", folder / "buses") as sim:
        for bus in BUSES:
            sim.path(bus)
        yield text, sim


@contextlib.contextmanager
def running(
    text: str, monkeypatch: pytest.MonkeyPatch, excuse: str | None = None
) -> Iterator[tuple[RobotRig, lithe.Robot]]:
    """A robot of that file, armed, and this process its Brain. Skipped where its file is refused with this excuse."""
    with RobotRig() as rig:
        rig.config = rig.dir / "arm.toml"
        rig.config.write_text(text, encoding="utf-8")
        for key in ("LITHE_RUN_DIR", "LITHE_SHM_PREFIX", "LITHE_OUT_DIR"):
            monkeypatch.setenv(key, rig.env[key])
        process = rig.run(wait=excuse is None)
        rig.wait_for(lambda: rig.socket.exists() or process.poll() is not None)
        if process.poll() == REFUSED and excuse is not None and excuse in rig.log():
            pytest.skip(rig.log().strip().splitlines()[-1])
        assert process.poll() is None, rig.log()
        rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
        with connected() as robot:
            yield rig, robot
