# SPDX-License-Identifier: Apache-2.0
"""`lithe sim`: simulated devices on terminals, with faults on order, as a script sees it."""

import contextlib
import os
import select
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from system.robot_rig import BIN, ROOT
from system.simulated import Simulated

QUERY = b"can send 8001 11001F01130D BF\n"
ANSWER = b"rcv 0100 2100002F01"  # what it begins with; other devices of the bus may speak before it


class Wire:
    """A terminal opened as any program would, without a word about its modes."""

    def __init__(self, path: Path) -> None:
        """Opens it; an adapter notices within a moment."""
        self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def say(self, line: bytes, want: bytes, timeout_s: float = 60.0) -> bytes:
        """What comes back until `want` is in it, or time is over."""
        os.write(self.fd, line)
        come = b""
        end = time.monotonic() + timeout_s
        while want not in come and (left := end - time.monotonic()) > 0:
            if select.select([self.fd], [], [], left)[0]:
                with contextlib.suppress(OSError):
                    come += os.read(self.fd, 4096)
        return come

    def close(self) -> None:
        """Hangs up."""
        os.close(self.fd)


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[Simulated]:
    """The arm's one bus, served."""
    with Simulated(ROOT / "robots" / "arm.toml", tmp_path) as served:
        yield served


def test_a_line_for_each_bus_a_link_to_each_and_no_trace_afterwards(arm: Simulated) -> None:
    name, kind, path = arm.line().split(" ")
    assert (name, kind) == ("can0", "fdcanusb")
    assert arm.path().resolve() == Path(path)
    wire = Wire(arm.path())
    assert ANSWER in wire.say(QUERY, ANSWER)
    wire.close()
    assert arm.close() == 0
    assert list(arm.folder.iterdir()) == []


def test_orders_are_obeyed_or_refused(arm: Simulated) -> None:
    wire = Wire(arm.path())
    assert arm.order(fault="bus_off") == {"ok": True}
    assert b"rcv" not in wire.say(QUERY, b"rcv", 0.3)
    assert b"busoff=1" in wire.say(b"can status\n", b"tdc")
    assert arm.order(fault="bus_off", on=False) == {"ok": True}
    assert b"rcv" not in wire.say(QUERY, b"rcv", 0.3), "the wires are good again, the adapter has given up"
    assert wire.say(b"can off\ncan on\n", b"OK\r\nOK").count(b"OK") >= 2
    assert b"rcv" in wire.say(QUERY, b"rcv")
    assert arm.order(fault="jump")["ok"] is False
    assert "no bus 'can7'" in arm.order(fault="drop", share=1, bus="can7")["error"]
    wire.close()


def test_an_unplugged_terminal_hangs_up_and_comes_back(arm: Simulated) -> None:
    before = arm.path().resolve()
    arm.line()
    wire = Wire(before)
    assert b"rcv" in wire.say(QUERY, b"rcv")
    assert arm.order(fault="unplug", bus="can0", for_s=0.2) == {"ok": True}
    assert arm.lines == ["can0 fdcanusb unplugged"]
    while os.read(wire.fd, 4096):  # what was said before; then nothing, which is how a hang-up reads
        pass
    with pytest.raises(OSError, match="Input/output error"):
        os.write(wire.fd, QUERY)
    wire.close()
    assert arm.line().startswith("can0 fdcanusb /dev/")
    wire = Wire(arm.path())
    assert b"rcv" in wire.say(QUERY, b"rcv")
    wire.close()


def test_buses_of_every_kind_side_by_side(tmp_path: Path) -> None:
    text = (ROOT / "robots" / "frankenstein.toml").read_text()
    slcan = 'name = "can2"\nkind = "slcan"\npath = "/dev/null"'
    mixed = tmp_path / "mixed.toml"
    assert text.count('name = "can2"\nkind = "loop"') == 1
    mixed.write_text(text.replace('name = "can2"\nkind = "loop"', slcan).replace("../laws", str(ROOT / "laws")))
    with Simulated(mixed, tmp_path / "links") as served:
        kinds = [served.line().split(" ")[:2] for _ in range(3)]
        assert kinds == [["can0", "fdcanusb"], ["can1", "fdcanusb"], ["can2", "slcan"]]
        for bus in ("can0", "can1"):
            wire = Wire(served.path(bus))
            assert ANSWER in wire.say(QUERY, ANSWER)
            wire.close()
        wire = Wire(served.path("can2"))
        assert b"V1013\r" in wire.say(b"V\r", b"V1013\r")
        assert b"t701" in wire.say(b"S8\rO\rt00028200\r", b"t701"), "a drive that was reset boots up"
        wire.close()
        assert served.close() == 0


def test_faults_from_the_start_and_nobody_at_the_standard_input(tmp_path: Path) -> None:
    fault = '{"fault": "drop", "share": 1}'
    with Simulated(ROOT / "robots" / "arm.toml", tmp_path, "--fault", fault, "--seed", "3", orders=False) as served:
        wire = Wire(served.path())
        assert b"OK" in wire.say(QUERY, b"OK")
        assert b"rcv" not in wire.say(QUERY, b"rcv", 0.3)
        wire.close()
        assert served.close() == 0


def test_what_cannot_be_served_is_refused_with_a_reason(tmp_path: Path) -> None:
    def refused(*words: str) -> tuple[int, str]:
        command = [BIN / "lithe", "sim", *words]
        ran = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60, stdin=subprocess.DEVNULL)
        return ran.returncode, ran.stderr

    arm = str(ROOT / "robots" / "arm.toml")
    code, why = refused("nothing.toml")
    assert code == 2 and "nothing.toml: No such file" in why
    code, why = refused(arm, "--fault", "{}")
    assert code == 2 and "must be one of drop" in why
    assert refused()[0] == 2
    assert refused(arm, "--jump")[0] == 2
    canned = tmp_path / "canned.toml"
    canned.write_text(Path(arm).read_text().replace('kind = "loop"', 'kind = "socketcan"\ninterface = "nocan7"'))
    code, why = refused(str(canned))
    assert code == 1 and "nocan7" in why
