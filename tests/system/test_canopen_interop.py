# SPDX-License-Identifier: Apache-2.0
"""CANopen against a library that is not ours, both ways, over slcan on terminals: our driver and its LocalNode, its
BaseNode402 and our simulated drive."""

import json
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import canopen
import pytest
from canopen.profiles.p402 import BaseNode402
from system.canopen_house import JoinedTerminals, ThirdPartyDrive, dictionary, network_on, wait_for
from system.house import BIN, need

NODE = 5
OFF, ENABLED, FAULT = 1, 4, 7
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

    def until(self, **wanted: object) -> dict[str, Any]:
        """Waits until it tells all this; values may be tests."""

        def holds() -> dict[str, Any] | None:
            now = self.now
            for name, value in wanted.items():
                if name not in now or not (value(now[name]) if callable(value) else now[name] == value):
                    return None
            return now

        try:
            found: dict[str, Any] = wait_for(holds)
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


@pytest.fixture
def line() -> Iterator[JoinedTerminals]:
    """A line with two ends."""
    terminals = JoinedTerminals()
    yield terminals
    terminals.close()


Pair = Callable[..., tuple[OurDriver, ThirdPartyDrive]]


@pytest.fixture
def pair(line: JoinedTerminals) -> Iterator[Pair]:
    """Our driver at one end, their node at the other."""
    with network_on(line.paths[1]) as network:
        drivers: list[OurDriver] = []

        def make(mode: str = "torque", without: tuple[int, ...] = ()) -> tuple[OurDriver, ThirdPartyDrive]:
            drive = ThirdPartyDrive(network, NODE, without)
            drivers.append(OurDriver(line.paths[0], mode))
            return drivers[0], drive

        yield make
        for driver in drivers:
            driver.close()


def test_our_driver_sets_up_and_moves_their_node(pair: Pair) -> None:
    """From the reset to torque, and what the set-up left in their dictionary."""
    ours, theirs = pair()
    ours.until(fresh=True, state=OFF, why="")
    sdo = theirs.node.sdo
    assert sdo[0x1016][1].raw == 127 << 16 | 1000
    assert (sdo[0x6007].raw, sdo[0x605A].raw, sdo[0x6060].raw) == (3, 2, 10)
    assert sdo[0x6072].raw == 1000
    assert (sdo[0x60C2][1].raw, sdo[0x60C2][2].raw) == (5, -3)
    assert [v.index for v in theirs.node.rpdo[1]] == [0x6040, 0x6071]
    assert [v.index for v in theirs.node.tpdo[1]] == [0x606C]
    assert [v.index for v in theirs.node.tpdo[2]] == [0x6041, 0x6064, 0x6077]
    ours.order("torque", -0.5)  # a tenth of the motor's rated torque, the other way round behind the gear
    now = ours.until(fresh=True, state=ENABLED, torque_nm=lambda nm: abs(nm + 0.5) < 1e-3)
    assert theirs.torque == 100
    further = ours.until(position_rad=lambda rad: rad < now["position_rad"] - 0.05)
    assert further["velocity_rad_s"] < 0
    ours.order("off")
    ours.until(state=OFF, torque_nm=0)


def test_our_driver_leads_their_node_by_position_and_by_velocity(pair: Pair) -> None:
    """A target starts where the drive is."""
    ours, theirs = pair("position")
    at_rest = ours.until(fresh=True, state=OFF)["position_rad"]
    ours.order("torque", 0)
    assert abs(ours.until(state=ENABLED)["position_rad"] - at_rest) < 1e-3
    ours.order("position", at_rest + 0.25)
    ours.until(fresh=True, position_rad=lambda rad: abs(rad - at_rest - 0.25) < 1e-3)
    assert theirs.position == pytest.approx(100 - 0.25 * 10 * 4096 / 6.283185, abs=2)


def test_our_driver_reports_their_fault_and_resets_it_when_asked(pair: Pair) -> None:
    """Fault by emergency; reset only by off, then torque."""
    ours, theirs = pair()
    ours.until(fresh=True, state=OFF)
    ours.order("torque", 0)
    ours.until(state=ENABLED)
    theirs.fail(0x4210)
    ours.until(fault=True, state=FAULT, fault_class=0x42)
    ours.order("torque", 0.1)
    assert ours.until(fault=True)
    assert theirs.state == "fault"
    ours.order("off")
    wait_for(lambda: theirs.control == 0)
    ours.order("torque", 0)
    ours.until(fault=False, state=ENABLED, fault_class=0)


def test_our_driver_sets_their_node_up_again_after_a_restart(pair: Pair) -> None:
    """A boot-up message in the middle."""
    ours, theirs = pair()
    ours.until(fresh=True, state=OFF)
    with theirs.lock:
        theirs.power_on()
        theirs.boot()
    ours.until(fresh=False)
    ours.until(fresh=True, state=OFF, why="")
    assert theirs.node.sdo[0x6007].raw == 3


def test_our_driver_names_what_their_node_lacks(pair: Pair) -> None:
    """An SDO abort, in words."""
    ours, _ = pair(without=(0x6007,))
    why = ours.until(why=lambda text: "6007h" in text)["why"]
    assert "no such object" in why
    assert ours.now["fresh"] is False


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


@pytest.fixture
def our_drive(tmp_path: Path) -> Iterator[OurDrive]:
    """Our simulated drive behind a simulated adapter."""
    drive = OurDrive(tmp_path)
    yield drive
    drive.close()


@pytest.fixture
def their_master(our_drive: OurDrive) -> Iterator[BaseNode402]:
    """Their master, SYNC every 10 ms, process data mapped by their own hand; operational."""
    with network_on(str(our_drive.path)) as network:
        node = BaseNode402(NODE, dictionary(NODE))
        network.add_node(node)
        heard: list[int] = []
        node.nmt.add_heartbeat_callback(heard.append)  # their wait_for_bootup() may begin when it is over
        node.nmt.state = "RESET"
        wait_for(lambda: 0 in heard)
        node.tpdo.read()
        node.rpdo.read()
        for pdo, objects, kind in ((node.tpdo[1], (0x6041, 0x6061), 1), (node.tpdo[2], (0x6064, 0x606C), 1)):
            remap(pdo, objects, kind)
        # Of a process data that waits for SYNC the library believes that somebody sends it already.
        remap(node.rpdo[1], (0x6040, 0x6060), 255)
        remap(node.rpdo[2], (0x6071,), 255)
        node.setup_402_state_machine()
        network.sync.start(0.01)
        node.nmt.state = "OPERATIONAL"
        yield node
        network.sync.stop()


def remap(pdo: canopen.pdo.PdoMap, objects: tuple[int, ...], kind: int) -> None:
    """Map these objects, with their library's own order of writes."""
    pdo.clear()
    for index in objects:
        pdo.add_variable(index)
    pdo.trans_type = kind
    pdo.enabled = True
    pdo.save()


def test_their_master_reads_our_dictionary(our_drive: OurDrive) -> None:
    """Expedited and segmented uploads, and aborts that it knows by code."""
    with network_on(str(our_drive.path)) as network:
        node = network.add_node(NODE, dictionary(NODE))
        assert node.sdo[0x1000].raw == 0x00020192
        assert node.sdo[0x1008].raw == "LITHE simulated CiA 402 drive"
        assert node.sdo[0x6502].raw == 0x380
        assert node.sdo[0x6076].raw == 500
        node.sdo[0x605A].raw = 6
        assert node.sdo[0x605A].raw == 6
        for index, code in ((0x2000, 0x06020000), (0x6041, 0x06010002)):
            with pytest.raises(canopen.SdoAbortedError) as told:
                node.sdo.download(index, 0, b"\0\0")
            assert told.value.code == code
        with pytest.raises(canopen.SdoAbortedError) as told:
            node.sdo.upload(0x1018, 9)
        assert told.value.code == 0x06090011
        node.sdo[0x1017].raw = 20
        assert node.nmt.wait_for_heartbeat(5) == "PRE-OPERATIONAL"


def test_their_master_enables_and_turns_our_drive(their_master: BaseNode402) -> None:
    """Their state machine against ours, from off to torque to quick stop."""
    wait_for(lambda: their_master.state == "SWITCH ON DISABLED")
    their_master.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
    assert their_master.op_mode == "CYCLIC SYNCHRONOUS TORQUE"
    their_master.state = "OPERATION ENABLED"
    assert their_master.state == "OPERATION ENABLED"
    before = their_master.tpdo[2][0x6064].raw
    their_master.rpdo[2][0x6071].raw = 200
    their_master.rpdo[2].transmit()
    wait_for(lambda: their_master.tpdo[2][0x6064].raw > before + 1000)
    assert their_master.tpdo[2][0x606C].raw > 0
    their_master.state = "QUICK STOP ACTIVE"
    wait_for(lambda: their_master.state == "SWITCH ON DISABLED")
    wait_for(lambda: abs(their_master.tpdo[2][0x606C].raw) < 400)


def test_their_master_sees_our_fault_and_resets_it(our_drive: OurDrive, their_master: BaseNode402) -> None:
    """An emergency, the state, the reset by their own recipe."""
    their_master.op_mode = "CYCLIC SYNCHRONOUS VELOCITY"
    their_master.state = "OPERATION ENABLED"
    our_drive.order({"fault": "over_temperature", "on": True})
    wait_for(lambda: [error.code for error in their_master.emcy.active] == [0x4210])
    wait_for(lambda: their_master.state == "FAULT")
    our_drive.order({"fault": "over_temperature", "on": False})
    their_master.reset_from_fault()
    assert their_master.state == "OPERATION ENABLED"
    wait_for(lambda: their_master.emcy.active == [])


def test_our_drive_stops_when_their_heartbeat_does(their_master: BaseNode402) -> None:
    """Object 1016h against a heartbeat that their library sends."""
    network = their_master.network
    beat = network.send_periodic(0x77F, [5], 0.05)
    their_master.sdo[0x6007].raw = 3
    their_master.sdo[0x1016][1].raw = 127 << 16 | 500
    time.sleep(0.5)  # a watch begins with the first beat
    their_master.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
    their_master.state = "OPERATION ENABLED"
    their_master.rpdo[2][0x6071].raw = 100
    their_master.rpdo[2].transmit()
    wait_for(lambda: their_master.tpdo[2][0x606C].raw > 500)
    beat.stop()
    wait_for(lambda: [error.code for error in their_master.emcy.log] == [0x8130])
    wait_for(lambda: their_master.sdo[0x6041].raw & 0x4F == 0x40)  # off, told by SDO: process data has ended
    assert abs(their_master.sdo[0x606C].raw) < 1000
