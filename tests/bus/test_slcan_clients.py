# SPDX-License-Identifier: Apache-2.0
"""python-can speaks with both our ends of slcan, over terminals: every kind of frame, there and back."""

import os
import random
import select
import subprocess
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can

ROOT = Path(__file__).parent.parent.parent
PEER = Path(os.environ.get("LITHE_BIN_DIR", ROOT / "build/release/bin")) / "slcan_peer"
LENGTHS = [*range(9), 12, 16, 20, 24, 32, 48, 64]


@contextmanager
def joined(one: tuple[int, int], other: tuple[int, int]) -> Iterator[None]:
    """Whatever can be read from one end is written to the other: two (read, write) pairs of descriptors."""
    over = threading.Event()

    def pump() -> None:
        while not over.is_set():
            for source in select.select([one[0], other[0]], [], [], 0.05)[0]:
                os.write(other[1] if source == one[0] else one[1], os.read(source, 4096))

    thread = threading.Thread(target=pump)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def terminal() -> tuple[int, str]:
    """Our end of a new terminal, and the path of the other one; no byte of its own."""
    master, slave = os.openpty()
    tty.setraw(slave)
    return master, os.ttyname(slave)


def client(path: str) -> can.Bus:
    """python-can on a serial device, classic and FD at 1 and 5 Mbit/s."""
    timing = can.BitTimingFd.from_sample_point(
        f_clock=80_000_000, nom_bitrate=1_000_000, nom_sample_point=75, data_bitrate=5_000_000, data_sample_point=75
    )
    return can.Bus(interface="slcan", channel=path, timing=timing, sleep_after_open=0)


def frames() -> Iterator[can.Message]:
    """One of each kind and length."""
    bytes_of = random.Random(4).randbytes
    for length in LENGTHS:
        for extended in (False, True):
            for fd, brs in ((False, False), (True, False), (True, True)):
                if fd or length <= 8:
                    yield can.Message(
                        arbitration_id=0x12345678 if extended else 0x123,
                        is_extended_id=extended,
                        is_fd=fd,
                        bitrate_switch=brs,
                        data=bytes_of(length),
                    )


def exchange(bus: can.Bus) -> int:
    """Sends each frame and holds its answer against it; how many there were."""
    all_kinds = list(frames())
    for sent in all_kinds:
        bus.send(sent)
        deadline = time.monotonic() + 30
        while (heard := bus.recv(timeout=1)) is None:
            assert time.monotonic() < deadline, f"no answer to {sent}"
        assert heard.arbitration_id == sent.arbitration_id + 1
        assert (heard.is_extended_id, heard.is_fd, heard.bitrate_switch) == (
            sent.is_extended_id,
            sent.is_fd,
            sent.bitrate_switch,
        )
        assert bytes(heard.data) == bytes(sent.data)
    return len(all_kinds)


def test_python_can_through_our_simulated_adapter() -> None:
    """Our adapter answers every command as LAWICEL's does, which the client passes over."""
    master, path = terminal()
    with subprocess.Popen([PEER, "adapter"], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as peer:
        assert peer.stdin is not None and peer.stdout is not None
        with joined((master, master), (peer.stdout.fileno(), peer.stdin.fileno())):
            bus = client(path)
            assert bus.get_version(timeout=30) == (10, 13)
            assert bus.get_serial_number(timeout=30) == "LTHE"
            assert exchange(bus) > 80
            bus.shutdown()
        peer.stdin.close()
        assert peer.wait(timeout=30) == 0


def test_python_can_as_the_adapter_of_our_own_bus() -> None:
    """Two hosts, line to line: each takes the other for an adapter."""
    ours, our_path = terminal()
    theirs, their_path = terminal()
    with subprocess.Popen([PEER, "host", our_path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as peer:
        opening = b""  # what arrives before our bus is open is lost: its last word is that it opens the channel
        while b"O\r" not in opening:
            assert select.select([ours], [], [], 30)[0], opening
            opening += os.read(ours, 4096)
        with joined((ours, ours), (theirs, theirs)):
            bus = client(their_path)
            number = exchange(bus)
            bus.shutdown()
        said, _ = peer.communicate(timeout=30)
    # What opens and closes a channel is no answer: C S8 Y5 O O of the client and its last C. Those that came before our
    # bus was opened, or after the line was cut, are not counted.
    assert said.startswith(f"received {number} sent {number} malformed ")
    assert int(said.split()[-1]) <= 6
