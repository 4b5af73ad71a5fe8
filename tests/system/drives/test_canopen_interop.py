# SPDX-License-Identifier: Apache-2.0
"""CANopen against a library that is not ours, both ways, over slcan on terminals: our driver and its LocalNode, its
BaseNode402 and our simulated drive."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import canopen
import pytest
from canopen.profiles.p402 import BaseNode402
from canopen.sdo import SdoClient
from system.drives.canopen_peers import NODE, OurDrive, OurDriver
from system.drives.canopen_rig import JoinedTerminals, ThirdPartyDrive, dictionary, network_on, wait_for

OFF, ENABLED, FAULT = 1, 4, 7
QUICK_STOP = 2
LATE = ("no heartbeat", "does not answer", "cannot be switched on")
LONG_S = 60.0


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process may stand still for longer than the 0.2 to 0.8 s that the library waits."""
    monkeypatch.setattr(SdoClient, "RESPONSE_TIMEOUT", LONG_S)
    for name in ("CHECK_TPDO", "SWITCH_OP_MODE", "SWITCH_STATE_SINGLE", "SWITCH_STATE_FINAL"):
        monkeypatch.setattr(BaseNode402, f"TIMEOUT_{name}", LONG_S)
    monkeypatch.setattr(canopen.Network, "NOTIFIER_CYCLE", 0.05)  # seconds until it notices that it is to end


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


def test_our_driver_leads_their_node_by_position(pair: Pair) -> None:
    """A target starts where the drive is."""
    ours, theirs = pair("position")
    at_rest = ours.until(fresh=True, state=OFF)["position_rad"]
    ours.order("torque", 0)
    assert abs(ours.until(state=ENABLED)["position_rad"] - at_rest) < 1e-3
    ours.order("position", at_rest + 0.25)
    ours.until(fresh=True, position_rad=lambda rad: abs(rad - at_rest - 0.25) < 1e-3)
    assert theirs.position == pytest.approx(100 - 0.25 * 10 * 4096 / 6.283185, abs=2)


def test_our_driver_leads_their_node_by_velocity(pair: Pair) -> None:
    """As fast as it is told, the other way round behind the gear; then at rest."""
    ours, theirs = pair("velocity")
    ours.until(fresh=True, state=OFF)
    ours.order("velocity", 0.5)
    now = ours.until(fresh=True, state=ENABLED, velocity_rad_s=lambda rad_s: abs(rad_s - 0.5) < 1e-3)
    assert theirs.velocity == pytest.approx(-0.5 * 10 * 4096 / 6.283185, abs=2)
    ours.until(position_rad=lambda rad: rad > now["position_rad"] + 0.1)
    ours.order("velocity", 0)
    ours.until(fresh=True, velocity_rad_s=0)
    assert theirs.velocity == 0


def test_our_driver_reports_their_fault_and_resets_it_when_asked(pair: Pair) -> None:
    """Fault by emergency; reset only by off, then torque."""
    ours, theirs = pair()
    ours.until(fresh=True, state=OFF)
    ours.order("torque", 0)
    ours.until(state=ENABLED)
    theirs.fail(0x4210)
    ours.until(fault=True, state=FAULT, fault_class=0x42)
    before = len(theirs.words)
    ours.order("torque", 0.1)
    wait_for(lambda: len(theirs.words) > before + 100)  # half a second of them, however long it takes
    assert theirs.state == "fault"
    assert not any(word & 0x80 for word in theirs.words[before:]), "torque alone resets nothing"
    # When their process has no time for a heartbeat or for the reset, the driver tells the drive to stop, and needs one
    # more off. It may say why, and no other reason is accepted.
    for _ in range(20):
        ours.order("off")
        wait_for(lambda: theirs.control == 0)
        ours.until(why="")
        ours.order("torque", 0)
        wait_for(lambda: theirs.control == QUICK_STOP or ours.now["state"] == ENABLED)
        if theirs.control != QUICK_STOP:
            break
        assert ours.now["why"].startswith(LATE) or not ours.now["why"]
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
        wait_for(lambda: answers(node.sdo))  # what was heard may be the boot-up from before the reset
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


def answers(sdo: SdoClient) -> bool:
    """Whether the node answers now: what it is asked before it resets is lost."""
    sdo.RESPONSE_TIMEOUT = 0.5
    try:
        return sdo[0x1000].raw is not None
    except canopen.SdoCommunicationError:
        return False
    finally:
        sdo.RESPONSE_TIMEOUT = LONG_S


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
        assert node.nmt.wait_for_heartbeat(LONG_S) == "PRE-OPERATIONAL"


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
    their_master.sdo[0x1016][1].raw = 127 << 16 | 3000  # and not because this process had no processor time
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
