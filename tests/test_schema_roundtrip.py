# SPDX-License-Identifier: Apache-2.0
"""C++ and Python mean the same by every field of every message, and speak the same protocols over shared memory."""

import random
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lithe import _wire, shm
from lithe.shim import load_shim
from lithe.shm import BrainWriter, SpineView
from segments import own_prefix, remove
from system.robot_rig import BIN, need

ROOT = Path(__file__).resolve().parents[1]
ROBOT = "arm"
ROUNDS = 5


class Peer:
    """The C++ side: a line of question, a line of answer."""

    def __init__(self) -> None:
        """Start it."""
        need("wire_peer")
        self.process = subprocess.Popen([BIN / "wire_peer"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def send(self, *words: object) -> None:
        """Ask without waiting."""
        assert self.process.stdin is not None
        self.process.stdin.write(" ".join(str(word) for word in words) + "\n")
        self.process.stdin.flush()

    def receive(self) -> str:
        """The next answer."""
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()

    def ask(self, *words: object) -> str:
        """Ask and wait."""
        self.send(*words)
        return self.receive()

    def close(self) -> None:
        """End it."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        self.process.stdout.close()
        assert self.process.wait(20) == 0


@pytest.fixture
def peer(monkeypatch: pytest.MonkeyPatch) -> Iterator[Peer]:
    """A C++ side with a shared-memory prefix of its own."""
    monkeypatch.setenv("LITHE_SHM_PREFIX", own_prefix())
    process = Peer()
    yield process
    try:
        process.close()
    finally:
        remove(ROBOT)


def noise(message: str, seed: int) -> bytes:
    """Random bytes for one message."""
    return random.Random(f"{message} {seed}").randbytes(_wire.SIZES[message])


def record(message: str, data: bytes) -> np.ndarray[Any, Any]:
    """The same bytes as numpy sees them."""
    return np.frombuffer(bytearray(data), shm.dtype(message)).reshape(())


@pytest.mark.parametrize("message", list(_wire.DTYPES))
def test_every_field_of_random_bytes_is_the_same_number_on_both_sides(peer: Peer, message: str) -> None:
    for seed in range(ROUNDS):
        data = noise(message, seed)
        here = record(message, data)
        told = [field.split(":") for field in peer.ask("values", message, data.hex()).split()]
        assert [name for name, _, _ in told] == list(here.dtype.names or ())
        for name, size, numbers in told:
            there = b"".join(int(number, 16).to_bytes(int(size), "little") for number in numbers.split(","))
            assert there == here[name].tobytes(), f"{message}.{name} as numpy sees it"


@pytest.mark.parametrize("message", list(_wire.DTYPES))
def test_every_field_set_in_cpp_lies_where_python_reads_it(peer: Peer, message: str) -> None:
    for seed in range(ROUNDS):
        data = noise(message, seed)
        here = record(message, data)
        numbers = []
        for name in here.dtype.names or ():
            raw = here[name].tobytes()
            size = 1 if here[name].dtype.kind == "S" else here[name].dtype.itemsize
            numbers += [f"{int.from_bytes(raw[i : i + size], 'little'):x}" for i in range(0, len(raw), size)]
        assert bytes.fromhex(peer.ask("bytes", message, *numbers)) == data


def test_both_sides_were_made_from_one_schema(peer: Peer) -> None:
    assert int.from_bytes(bytes.fromhex(peer.ask("layout")), "little") == _wire.LAYOUT_HASH


def test_what_the_spine_publishes_reaches_python_bit_by_bit(peer: Peer) -> None:
    assert peer.ask("spine", ROBOT) == "ok"
    info = record("RobotInfo", noise("RobotInfo", 0))
    info["joint_count"] = 3
    assert peer.ask("set", "robot_info", info.tobytes().hex()) == "ok"
    view = SpineView(ROBOT)
    events = view.events()
    assert view.info.tobytes() == info.tobytes()
    for item, message in (
        ("params", "Params"),
        ("telemetry", "Telemetry"),
        ("events_tick", "Event"),
        ("bus", "Histogram"),
    ):
        assert peer.ask("set", item, noise(message, 1).hex()) == "ok"
    law = record("LawInfo", noise("LawInfo", 1))
    law["law_id"] = 4
    peer.ask("set", "law_info", law.tobytes().hex())
    params, telemetry = view.params(), view.latest()
    assert params is not None
    assert telemetry is not None
    assert params.tobytes() == noise("Params", 1)
    assert telemetry.tobytes() == noise("Telemetry", 1)
    assert [each.tobytes() for each in events.drain()] == [noise("Event", 1)]
    assert [each.tobytes() for each in view.laws()] == [law.tobytes()]
    assert view.histogram("bus").tobytes() == noise("Histogram", 1)[: 8 * _wire.NBIN]
    assert view.is_alive(within_s=60)


def test_plans_and_the_estop_reach_the_spine(peer: Peer) -> None:
    peer.ask("spine", ROBOT)
    brain = BrainWriter(ROBOT)
    assert peer.ask("plan") == "none"
    for plan_id in range(1, 20):
        positions = np.full((5, 2), plan_id / 3)
        brain.publish(plan_id, np.arange(5) + plan_id, positions)
        plan = record("Plan", bytes.fromhex(peer.ask("plan")))
        assert (plan["plan_id"], plan["waypoint_count"], plan["joint_count"]) == (plan_id, 5, 2)
        assert (plan["position_rad"].reshape(_wire.NW, _wire.NJ)[:5, :2] == positions).all()
        assert np.isnan(plan["velocity_rad_s"]).all()
        assert peer.ask("plan") == "none"
    brain.press_estop()
    assert peer.ask("estop") == "1"
    brain.close()


def test_commands_of_the_brain_are_taken_in_order_and_answered(peer: Peer) -> None:
    peer.ask("spine", ROBOT)
    brain = shm.Mapping(ROBOT, "brain", writable=True)
    spine = shm.Mapping(ROBOT, "spine", writable=False)
    item, letters = brain.item("commands")
    ack = spine.item("brain_ack")[1]
    sent: list[tuple[int, bytes]] = []
    for number in range(50):
        letter = record("Command", noise("Command", number))
        ticket = shm.shim().lithe_mailbox_send(letters, ack, item.depth, letter.ctypes.data, letter.nbytes)
        if ticket == 0:
            assert len(sent) == item.depth, "full only when it is full"
            while sent:
                first, data = sent.pop(0)
                assert shm.shim().lithe_mailbox_poll(ack, item.depth, first) == 0
                assert peer.ask("receive", 1 + number % 8) == f"{first} {data.hex()}"
                assert shm.shim().lithe_mailbox_poll(ack, item.depth, first) == 1 + number % 8
            assert peer.ask("receive", 1) == "none"
        else:
            sent.append((ticket, letter.tobytes()))


def read_at_full_speed(peer: Peer, total: int) -> tuple[int, int]:
    """Reads while the Spine streams; how many records were read and how many of those were torn."""
    info = record("RobotInfo", bytes(_wire.SIZES["RobotInfo"]))
    peer.ask("set", "robot_info", info.tobytes().hex())
    view = SpineView(ROBOT)
    cursor = view.telemetry(from_oldest=True)
    peer.send("stream", total)
    read = torn = 0
    while read + cursor.lost < total:
        records = cursor.drain(256)
        newest = view.latest()
        for batch in (records, *([] if newest is None else [newest.reshape(1)])):
            whole = [(batch[name] == batch["tick"][:, None]).all(1) for name in ("position_rad", "joint_status")]
            torn += int((~np.logical_and(*whole)).sum())
        read += len(records)
    assert peer.receive() == "ok"
    assert len(cursor.drain()) == 0, "each record was either read or counted as lost, and none twice"
    return read, torn


def test_python_never_takes_a_torn_record_from_a_spine_at_full_speed(peer: Peer) -> None:
    peer.ask("spine", ROBOT)
    read, torn = read_at_full_speed(peer, 300_000)
    assert read > 0
    assert torn == 0


def test_a_shim_without_the_second_look_at_the_sequence_is_caught(
    peer: Peer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The broken twin of read_record: the test above is worth something."""
    text = (ROOT / "brain/lithe/_shm/lithe_shm.c").read_text()
    look = "return atomic_load_explicit(slot, memory_order_relaxed) == expected;"
    assert text.count(look) == 1
    (tmp_path / "twin.c").write_text(text.replace(look, "return 1;"))
    command = ["cc", "-std=c11", "-O2", "-shared", "-fPIC", "-o", tmp_path / "twin.so", tmp_path / "twin.c"]
    subprocess.run(command, check=True)
    monkeypatch.setenv("LITHE_SHM_LIB", str(tmp_path / "twin.so"))
    twin = load_shim()
    monkeypatch.setattr(shm, "shim", lambda: twin)
    for _ in range(100):
        peer.ask("spine", ROBOT)
        if read_at_full_speed(peer, 300_000)[1] > 0:
            return
    pytest.fail("a reader that takes torn records was not noticed")
