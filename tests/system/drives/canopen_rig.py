# SPDX-License-Identifier: Apache-2.0
"""Third-party CANopen (the package `canopen`) on serial lines: a dictionary, a drive, two joined terminals."""

import contextlib
import os
import select
import threading
import time
import tty
from collections.abc import Iterator
from typing import Any

import can
import canopen
from canopen.objectdictionary import (
    INTEGER8,
    INTEGER16,
    INTEGER32,
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    VISIBLE_STRING,
    ObjectDictionary,
    ODRecord,
    ODVariable,
)

BITS = {INTEGER8: 8, INTEGER16: 16, INTEGER32: 32, UNSIGNED8: 8, UNSIGNED16: 16, UNSIGNED32: 32}
# (index, type, access, value after power-on) of all that has no subindex
VARIABLES: list[tuple[int, int, str, Any]] = [
    (0x1000, UNSIGNED32, "ro", 0x00020192),
    (0x1001, UNSIGNED8, "ro", 0),
    (0x1008, VISIBLE_STRING, "ro", "third-party drive"),
    (0x1017, UNSIGNED16, "rw", 0),
    (0x6007, INTEGER16, "rw", 1),
    (0x603F, UNSIGNED16, "ro", 0),
    (0x6040, UNSIGNED16, "rw", 0),
    (0x6041, UNSIGNED16, "ro", 0x0250),
    (0x605A, INTEGER16, "rw", 2),
    (0x6060, INTEGER8, "rw", 0),
    (0x6061, INTEGER8, "ro", 0),
    (0x6064, INTEGER32, "ro", 0),
    (0x606C, INTEGER32, "ro", 0),
    (0x6071, INTEGER16, "rw", 0),
    (0x6072, UNSIGNED16, "rw", 1000),
    (0x6076, UNSIGNED32, "ro", 500),
    (0x6077, INTEGER16, "ro", 0),
    (0x607A, INTEGER32, "rw", 0),
    (0x60B2, INTEGER16, "rw", 0),
    (0x60FF, INTEGER32, "rw", 0),
    (0x6502, UNSIGNED32, "ro", 0x380),
]
# index, then (subindex, type, access, value)
RECORDS: dict[int, list[tuple[int, int, str, int]]] = {
    0x1016: [(0, UNSIGNED8, "ro", 1), (1, UNSIGNED32, "rw", 0)],
    0x1018: [(0, UNSIGNED8, "ro", 4), *((i, UNSIGNED32, "ro", 0) for i in range(1, 5))],
    0x60C2: [(0, UNSIGNED8, "ro", 2), (1, UNSIGNED8, "rw", 1), (2, INTEGER8, "rw", -3)],
}


def dictionary(node: int, without: tuple[int, ...] = (), values: dict[int, int] | None = None) -> ObjectDictionary:
    """The objects of a CiA 402 drive with four process data each way, those of one way off but for the first."""
    objects = ObjectDictionary()
    for index, kind, access, value in VARIABLES:
        if index in without:
            continue
        variable = ODVariable(f"object {index:04X}", index)
        variable.data_type, variable.access_type = kind, access
        variable.default = (values or {}).get(index, value)
        objects.add_object(variable)
    records = {index: members for index, members in RECORDS.items() if index not in without}
    for i in range(4):
        off = 0x80000000 if i else 0
        for communication, cob in ((0x1400, 0x200), (0x1800, 0x180)):
            records[communication + i] = [
                (0, UNSIGNED8, "ro", 5),
                (1, UNSIGNED32, "rw", off | cob + 0x100 * i + node),
                (2, UNSIGNED8, "rw", 255),
                (3, UNSIGNED16, "rw", 0),
                (5, UNSIGNED16, "rw", 0),
            ]
        for mapping in (0x1600, 0x1A00):
            records[mapping + i] = [(0, UNSIGNED8, "rw", 0), *((n, UNSIGNED32, "rw", 0) for n in range(1, 9))]
    for index, members in records.items():
        record = ODRecord(f"record {index:04X}", index)
        for subindex, kind, access, value in members:
            member = ODVariable(f"{index:04X}:{subindex}", index, subindex)
            member.data_type, member.access_type, member.default = kind, access, value
            record.add_member(member)
        objects.add_object(record)
    return objects


class JoinedTerminals:
    """Two pseudo terminals; what one is told, the other hears. No adapter between them: slcan is alike both ways."""

    def __init__(self) -> None:
        """Open and join them."""
        pairs = [os.openpty() for _ in range(2)]
        self.masters = [master for master, _ in pairs]
        self.slaves = [slave for _, slave in pairs]  # kept open: a terminal that nobody holds hangs up
        for slave in self.slaves:
            tty.setraw(slave)
        self.paths = [os.ttyname(slave) for slave in self.slaves]
        self.over = threading.Event()
        # A thread each way: one for both would wait for a reader that waits for it.
        ways = [(self.masters[0], self.masters[1]), (self.masters[1], self.masters[0])]
        self.pumps = [threading.Thread(target=self._carry, args=way, daemon=True) for way in ways]
        for pump in self.pumps:
            pump.start()

    def _carry(self, source: int, sink: int) -> None:
        while not self.over.is_set():
            if select.select([source], [], [], 0.1)[0] and select.select([], [sink], [], 0.1)[1]:
                os.write(sink, os.read(source, 256))

    def close(self) -> None:
        """Take them apart."""
        self.over.set()
        for pump in self.pumps:
            pump.join()
        for fd in self.masters + self.slaves:
            os.close(fd)


@contextlib.contextmanager
def network_on(path: str) -> Iterator[canopen.Network]:
    """The package's network on python-can's slcan."""
    bus = can.Bus(interface="slcan", channel=path, bitrate=1_000_000, sleep_after_open=0)
    network = canopen.Network(bus)
    network.connect()
    try:
        yield network
    finally:
        network.disconnect()


class ThirdPartyDrive:
    """A LocalNode: its SDO server, network states, heartbeats, emergencies and process data are the package's own.

    Only what the package has no idea of is ours: the states of a drive, and a motor that turns as its torque says.
    """

    COUNTS = 4096

    def __init__(
        self,
        network: canopen.Network,
        node: int,
        without: tuple[int, ...] = (),
        values: dict[int, int] | None = None,
    ) -> None:
        """Put it on the network and boot it. `values`: of objects, other than usual."""
        self.network = network
        self.node = network.create_node(node, dictionary(node, without, values))
        self.lock = threading.RLock()
        self.fault_code = 0
        self.power_on()
        self.node.add_write_callback(self.on_write)
        network.subscribe(0x000, self.on_nmt)
        network.subscribe(0x080, self.on_sync)
        self.boot()

    def power_on(self) -> None:
        """Forget everything."""
        self.node.data_store.clear()
        self.state = "switch on disabled"
        self.control = 0
        self.words: list[int] = []  # every control word since the power came
        self.position = 100.0
        self.velocity = 0.0
        self.torque = 0
        self.boots = getattr(self, "boots", 0) + 1

    def boot(self) -> None:
        """Boot-up message, then pre-operational."""
        self.node.nmt.state = "INITIALISING"
        self.node.nmt.state = "PRE-OPERATIONAL"

    def on_write(self, index: int, subindex: int, od: object, data: bytes) -> None:
        """What was chosen is what is shown."""
        if index == 0x6060:
            self.node.set_data(0x6061, subindex, data)

    def on_nmt(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        """A reset or a start; the package itself has the rest."""
        if data[1] not in (0, self.node.id):
            return
        with self.lock:
            if data[0] in (0x81, 0x82):
                self.power_on()
                self.boot()
            elif data[0] == 0x01:
                self.node.tpdo.read()
                self.node.rpdo.read()

    def fail(self, code: int) -> None:
        """An error, told by an emergency."""
        with self.lock:
            self.fault_code = code
            self.state = "fault"
            self.node.emcy.send(code, 1)

    def obey(self, word: int) -> None:
        """The state machine of CiA 402, as far as a master without tricks needs it."""
        self.words.append(word)
        rising = word & ~self.control & 0x80
        self.control = word
        if self.state == "fault":
            if rising:
                self.state = "switch on disabled"
                self.fault_code = 0
                self.node.emcy.reset()
        elif not word & 2 or not word & 4:
            self.state = "switch on disabled"
        elif word & 15 == 6:
            self.state = "ready to switch on"
        elif word & 15 == 7 and self.state in ("ready to switch on", "operation enabled"):
            self.state = "switched on"
        elif word & 15 == 15 and self.state == "switched on":
            self.state = "operation enabled"

    def on_sync(self, _can_id: int, _data: bytearray, _timestamp: float) -> None:
        """Apply and sample."""
        with self.lock:
            if self.node.nmt.state != "OPERATIONAL":
                return
            told: dict[int, int] = {}
            for pdo in self.node.rpdo.values():
                if pdo.enabled and pdo.is_received:
                    told |= {variable.index: variable.raw for variable in pdo}
            self.obey(told.get(0x6040, 0))
            self.move(told)
            said = {0x6041: self.statusword(), 0x6064: round(self.position), 0x606C: round(self.velocity)}
            said[0x6077] = self.torque
            for pdo in self.node.tpdo.values():
                if not pdo.enabled:
                    continue
                for variable in pdo:
                    variable.raw = said[variable.index]
                pdo.transmit()

    def move(self, told: dict[int, int]) -> None:
        """One period of whatever mode was chosen: 8 position, 9 velocity, 10 torque."""
        period_s = 0.005
        mode = self.node.sdo[0x6060].raw
        enabled = self.state == "operation enabled"
        self.torque = told.get(0x6071, 0) if enabled and mode == 10 else 0
        if enabled and mode == 8:
            self.position = told[0x607A]
        elif enabled and mode == 9:
            self.velocity = told[0x60FF]
        elif not enabled:
            self.velocity = 0.0
        self.velocity += 5.0 * self.torque * period_s
        self.position += self.velocity * period_s

    def statusword(self) -> int:
        """As the profile codes a state."""
        codes = {"switch on disabled": 0x50, "ready to switch on": 0x31, "switched on": 0x33}
        return 0x0200 | (codes | {"operation enabled": 0x37, "fault": 0x18})[self.state]


def wait_for(what: Any, seconds: float = 90.0) -> Any:
    """The first true value of `what()`."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if value := what():
            return value
        time.sleep(0.01)
    raise AssertionError(f"not within {seconds} s")
