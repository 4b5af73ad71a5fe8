# SPDX-License-Identifier: Apache-2.0
"""Two programs: a robot on real buses has a Spine without a simulated device in it (docs/adr/0020)."""

import re
import subprocess
from pathlib import Path

from system.robot_rig import BIN, ROOT, RobotRig, need
from system.simulated import Simulated

# What the far end of a bus is made of: functions, and vtables, which stay where functions were inlined.
SIMULATED = re.compile(r"lithe::hal::(?:sim::\w+|LoopBus|BusNode)")
DRIVERS = ("moteus::MoteusDrive", "cia402::Cia402Drive", "gateway::Gateway", "FdcanusbBus", "SlcanBus", "SocketCanBus")


def symbols(program: str) -> str:
    """All that the linker put into it, one name a line."""
    need(program)
    command = ["nm", "--demangle", "--defined-only", BIN / program]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def simulated_in(names: str) -> set[str]:
    """The simulated parts among these symbols."""
    return set(SIMULATED.findall(names))


def exe_of(pid: int) -> str:
    """The name of the program that this process runs."""
    return Path(f"/proc/{pid}/exe").readlink().name


def test_no_simulated_device_is_in_the_spine_of_a_real_robot() -> None:
    real = symbols("lithe-spine")
    assert simulated_in(real) == set()
    assert [name for name in DRIVERS if f"lithe::hal::{name}" not in real] == [], "the symbols are there to be read"


def test_the_simulating_spine_is_told_apart() -> None:
    """The control: the same search finds every simulated device there."""
    names = simulated_in(symbols("lithe-spine-sim"))
    for part in ("SimMoteus", "SimCia402", "SimCia401", "SimGateway", "Chain", "Coupling"):
        assert f"lithe::hal::sim::{part}" in names
    assert "lithe::hal::LoopBus" in names


def test_the_real_spine_refuses_a_simulated_bus(rig: RobotRig) -> None:
    command = [BIN / "lithe-spine", rig.config]
    refused = subprocess.run(command, env=rig.env, capture_output=True, text=True, timeout=30, check=False)
    assert refused.returncode == 3
    assert "bus 'can0' is simulated, and this program drives real buses only; start lithe-spine-sim" in refused.stderr
    assert rig.segments() == []


def test_the_robot_file_chooses_the_program(rig: RobotRig) -> None:
    """A bus of kind "loop": the simulating one. The same robot at the terminals of a `lithe sim`: the other."""
    loop = rig.config.read_text()
    rig.run()
    assert exe_of(rig.ask("status")["spine_pid"]) == "lithe-spine-sim"
    rig.ask("stop")
    assert rig.started[-1].wait(30) == 0
    sim = Simulated(ROOT / "robots/arm.toml", rig.dir / "buses")
    try:
        rig.config.write_text(loop.replace('kind = "loop"', f'kind = "fdcanusb"\npath = "{sim.path()}"'))
        rig.run("--no-arm")
        assert exe_of(rig.ask("status")["spine_pid"]) == "lithe-spine"
    finally:
        sim.close()
