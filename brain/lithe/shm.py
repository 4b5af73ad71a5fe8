# SPDX-License-Identifier: Apache-2.0
"""Access to shared memory: private numpy copies of the Spine's data, and the Brain's own segment.

Every shared word is touched by the C shim alone (`_shm/lithe_shm.c`): pure Python cannot order its stores on ARM, and a
reader would accept torn values. Nothing here hands out a view of live memory.

Threads: one object per thread, but for BrainWriter, which may be shared. Errors: `ShmError` with what, where and what
to do next.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import mmap
import os
import pwd
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _wire
from .errors import BadPlan, ShmError
from .shim import shim
from .values import fields_of

SAFELY = os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK  # others may put links and pipes into /dev/shm
_TORN = 2**64 - 1
_NEW_LAW_S = 0.5  # the description of a law that has just begun to run may be that much later than its State


def dtype(message: str) -> np.dtype[Any]:
    """numpy dtype of a message of the schema, with the exact offsets and size of the C++ struct."""
    fields = _wire.DTYPES[message]
    return np.dtype(
        {
            "names": [name for name, _, _, _ in fields],
            "formats": [(fmt, shape) for _, fmt, shape, _ in fields],
            "offsets": [offset for _, _, _, offset in fields],
            "itemsize": _wire.SIZES[message],
        }
    )


def shm_path(robot: str, segment: str) -> Path:
    """/dev/shm/<prefix>.<robot>.<segment>; prefix $LITHE_SHM_PREFIX or "lithe"."""
    prefix = os.environ.get("LITHE_SHM_PREFIX") or "lithe"
    return Path(f"/dev/shm/{prefix}.{robot}.{segment}")


def schema_difference(ours: str, theirs: str) -> str:
    """Fields of ours that theirs lacks or has elsewhere, one pair of lines each; empty if every field is in place."""
    other = {line.split(":", 1)[0]: line for line in theirs.splitlines()}
    lines = []
    for line in ours.splitlines():
        name = line.split(":", 1)[0]
        if other.get(name) != line:
            lines.append(f"  here  {line}\n  there {other.get(name, '(absent)')}")
    return "\n".join(lines)


def _whose(path: str | Path) -> str:
    """Of a file that we may not open."""
    user = os.stat(path).st_uid
    with contextlib.suppress(KeyError):
        return f": it belongs to {pwd.getpwuid(user).pw_name}; join the group of that file, or run as its owner"
    return f": it belongs to uid {user}; join the group of that file, or run as its owner"


def _open_lock(path: str) -> int:
    """Without O_CREAT first: with it, the kernel refuses another group member's file (fs.protected_regular)."""
    try:
        return os.open(path, os.O_RDWR | SAFELY)
    except FileNotFoundError:
        return os.open(path, os.O_RDWR | os.O_CREAT | SAFELY, 0o660)


class Mapping:
    """One segment, mapped and checked."""

    def __init__(self, robot: str, segment: str, writable: bool) -> None:
        self.path = shm_path(robot, segment)
        self.segment = segment
        try:
            fd = os.open(self.path, (os.O_RDWR if writable else os.O_RDONLY) | SAFELY)
        except FileNotFoundError:
            raise ShmError(f"robot '{robot}' is not running ({self.path} is absent): lithe run ROBOT.toml") from None
        except PermissionError:
            raise ShmError(f"no right to open {self.path}{_whose(self.path)}") from None
        try:
            status = os.fstat(fd)
            length = status.st_size
            self._file = (status.st_dev, status.st_ino)
            if length < _wire.SEGMENT_BYTES[segment]:
                raise ShmError(f"{self.path} is too short for this build ({length} bytes): restart the robot")
            protection = mmap.PROT_READ | (mmap.PROT_WRITE if writable else 0)
            self._map = mmap.mmap(fd, length, flags=mmap.MAP_SHARED, prot=protection)
        finally:
            os.close(fd)
        self.base = self._address()
        self._check(length)

    def _address(self) -> int:
        # numpy tells the address of a read-only buffer; ctypes' from_buffer refuses one.
        view = np.frombuffer(self._map, dtype=np.uint8)
        return int(view.__array_interface__["data"][0])

    def _check(self, length: int) -> None:
        header = self.header()
        if header.magic != _wire.MAGIC:
            raise ShmError(f"{self.path} is not a LITHE segment: remove it and restart the robot")
        if header.layout_hash == _wire.LAYOUT_HASH:
            return
        start, count = header.schema_offset, header.schema_bytes
        if start + count > length:
            raise ShmError(f"{self.path}: its schema text lies outside the segment: remove it and restart the robot")
        theirs = bytes(self._map[start : start + count]).decode(errors="replace")
        difference = schema_difference(_wire.CANONICAL_SCHEMA, theirs)
        if difference:
            raise ShmError(
                f"{self.path} was made by a build with another layout:\n{difference}\nbuild both from one schema"
            )

    def is_current(self) -> bool:
        """False once the robot has ended or was started again: this memory is then not used any more."""
        try:
            status = os.stat(self.path)
        except OSError:
            return False
        return (status.st_dev, status.st_ino) == self._file

    def header(self) -> _wire.SegmentHeader:
        """A copy of the segment's header."""
        copy = _wire.SegmentHeader()
        shim().lithe_copy(ctypes.addressof(copy), self.base, ctypes.sizeof(copy))
        return copy

    def item(self, name: str, index: int = 0) -> tuple[_wire.Item, int]:
        """An item of the segment and its address."""
        item = _wire.SEGMENTS[self.segment][name]
        return item, self.base + item.offset + index * item.stride

    def load(self, name: str) -> int:
        """A sticky word."""
        return int(shim().lithe_load(self.item(name)[1]))

    def channel(self, name: str, index: int = 0) -> tuple[int, npt.NDArray[Any]] | None:
        """The latest value of a channel as (count, structured scalar array), None when there is none yet."""
        item, address = self.item(name, index)
        copy = np.zeros((), dtype(item.message))
        count = int(shim().lithe_channel_read(address, copy.ctypes.data, copy.dtype.itemsize))
        return None if count in (0, _TORN) else (count, copy)


class RingCursor:
    """A private cursor on a ring, at its end. `lost`: records overwritten before they were read."""

    def __init__(self, mapping: Mapping, name: str, from_oldest: bool = False) -> None:
        self._mapping = mapping  # keeps the memory mapped
        self._item, self._address = mapping.item(name)
        self._dtype = dtype(self._item.message)
        head = int(shim().lithe_ring_head(self._address))
        self._cursor = ctypes.c_uint64(max(0, head - (self._item.depth if from_oldest else 0)))
        self._lost = ctypes.c_uint64(0)

    @property
    def lost(self) -> int:
        return self._lost.value

    def go_back(self, records: int) -> None:
        """Read so many records again, or all there are."""
        self._cursor.value = max(0, self._cursor.value - records)

    def drain(self, most: int | None = None) -> npt.NDArray[Any]:
        """All records since the last call, oldest first: one call into the shim, one private array of shape (n,)."""
        count = self._item.depth if most is None else most
        records = np.empty(count, self._dtype)
        got = shim().lithe_ring_drain(
            self._address,
            self._item.depth,
            self._dtype.itemsize,
            ctypes.byref(self._cursor),
            records.ctypes.data,
            count,
            ctypes.byref(self._lost),
        )
        return records[:got].copy() if got < count // 2 else records[:got]

    def latest(self) -> npt.NDArray[Any] | None:
        """The newest record as a structured scalar array, None when there is none."""
        record = np.zeros((), self._dtype)
        count = shim().lithe_ring_latest(self._address, self._item.depth, self._dtype.itemsize, record.ctypes.data)
        return None if count in (0, _TORN) else record


class SpineView:
    """The data that the Spine publishes, read-only. `info` is its record RobotInfo, `joint_count` the joints."""

    def __init__(self, robot: str) -> None:
        self.robot = robot
        self.mapping = Mapping(robot, "spine", writable=False)
        info = self.mapping.channel("robot_info")
        if info is None:
            raise ShmError(f"robot '{robot}' has not finished starting: try again")
        self.info = info[1]
        self.joint_count = int(self.info["joint_count"])
        self._telemetry = RingCursor(self.mapping, "telemetry")
        self._names = np.array(self.info["joint_name"]).reshape(-1)
        self._sensors = np.array(self.info["sensor_name"]).reshape(-1)

    @property
    def joint_names(self) -> list[str]:
        """Names of the joints, in the order of every joint array."""
        return [bytes(name).decode() for name in self._names[: self.joint_count]]

    @property
    def sensor_names(self) -> list[str]:
        """Names of the sensors, in the order of `sensor` in telemetry."""
        return [bytes(name).decode() for name in self._sensors[: int(self.info["sensor_count"])]]

    def latest(self) -> npt.NDArray[Any] | None:
        """The newest telemetry record."""
        return self._telemetry.latest()

    def telemetry(self, from_oldest: bool = False) -> RingCursor:
        """A new cursor on the telemetry ring, with drain() and lost of its own."""
        return RingCursor(self.mapping, "telemetry", from_oldest)

    def events(self, source: str = "tick", from_oldest: bool = True) -> RingCursor:
        """A new cursor on the events of the `tick` or the `loader`."""
        return RingCursor(self.mapping, f"events_{source}", from_oldest)

    def laws(self) -> list[npt.NDArray[Any]]:
        """The resident laws (LawInfo records)."""
        infos = [self.mapping.channel("law_info", i) for i in range(_wire.NLAW)]
        return [value for entry in infos if entry is not None and (value := entry[1])["law_id"] != 0]

    def params(self) -> npt.NDArray[Any] | None:
        """Live parameter values of the running law (Params record)."""
        entry = self.mapping.channel("params")
        return None if entry is None else entry[1]

    def running_law(self) -> npt.NDArray[Any] | None:
        """The LawInfo of the law that ran in the newest tick; None when none did."""
        record = self.latest()
        laws = [] if record is None else [law for law in self.laws() if law["law_id"] == record["law_id"]]
        return laws[0] if laws else None

    def state(self) -> dict[str, Any]:
        """The State of the running law by field name: numbers and numpy arrays, at most 10 ms old.

        Empty when it has none. All of it is of one tick. Raises ShmError while no law has run yet.
        """
        entry = self.mapping.channel("law_state")
        until_s = time.monotonic() + _NEW_LAW_S
        while entry is not None:  # the law may be replaced between the two looks, and the Spine be held up meanwhile
            state = entry[1]
            laws = [law for law in self.laws() if law["law_id"] == state["law_id"]]
            if laws:
                return fields_of(laws[0], state["bytes"].tobytes()[: int(state["state_bytes"])])
            if time.monotonic() > until_s:
                break
            time.sleep(0.001)
            entry = self.mapping.channel("law_state")
        raise ShmError(f"no law of robot '{self.robot}' has published a State yet\n  next: robot.swap(), robot.arm()")

    def answer(self, ticket: int) -> int:
        """The Spine's answer (CommandResult) to a command of BrainWriter.send(); 0 while it is pending."""
        item, address = self.mapping.item("brain_ack")
        return int(shim().lithe_mailbox_poll(address, item.depth, ticket))

    def histogram(self, name: str) -> npt.NDArray[np.uint64]:
        """Bin counts of release_jitter, handoff, law, guard, tick or bus (bins: spine/core/histogram.hpp)."""
        _, address = self.mapping.item(name)
        bins = np.empty(_wire.NBIN, np.uint64)
        shim().lithe_copy(bins.ctypes.data, address, bins.nbytes)
        return bins

    def health(self) -> dict[str, int]:
        """Counts of invalid data that the Spine received since its start (message Health); normally all zero."""
        layout, (_, address) = dtype("Health"), self.mapping.item("health")
        words = np.empty(len(layout.names or ()), np.uint64)
        shim().lithe_copy(words.ctypes.data, address, words.nbytes)
        return dict(zip(layout.names or (), words.tolist(), strict=True))

    def is_alive(self, within_s: float = 1.0) -> bool:
        """True while the Spine's heartbeat is younger than that."""
        return time.monotonic_ns() - int(self.mapping.header().heartbeat_ns) < int(within_s * 1e9)


class BrainWriter:
    """The Brain's own segment: plans, the sticky e-stop, the heartbeat. One process at a time (lease)."""

    def __init__(self, robot: str) -> None:
        self.mapping = Mapping(robot, "brain", writable=True)
        lock = f"{self.mapping.path}.lock"
        try:
            self._lock = _open_lock(lock)
        except PermissionError:
            raise ShmError(f"no right to open {lock}{_whose(lock)}") from None
        with contextlib.suppress(PermissionError):  # it belongs to another user: leave its mode unchanged
            os.fchown(self._lock, -1, self.mapping.path.stat().st_gid)
            os.fchmod(self._lock, 0o660)  # the umask removed the group's permission
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._lock)
            pid = self.mapping.header().writer_pid
            raise ShmError(f"robot '{robot}' already has a Brain (pid {pid}): stop it first") from None
        self._header = self.mapping.base
        epoch = self._field("epoch")
        self._store("writer_pid", os.getpid())
        self._store("epoch", epoch + 1)
        self._plan = np.zeros((), dtype("Plan"))
        self._publishing = threading.Lock()
        self.beat()

    def _field(self, name: str) -> int:
        return int(shim().lithe_load(self._header + getattr(_wire.SegmentHeader, name).offset))

    def _store(self, name: str, value: int) -> None:
        shim().lithe_store(self._header + getattr(_wire.SegmentHeader, name).offset, value)

    def _check_lease(self) -> None:
        if self._lock < 0:
            raise ShmError("this Brain has left: what it writes now could be another Brain's\n  next: connect again")

    def beat(self) -> None:
        """A heartbeat. publish() sends one too."""
        self._check_lease()
        self._store("heartbeat_ns", time.monotonic_ns())

    def publish(
        self,
        plan_id: int,
        t_ns: npt.ArrayLike,
        position_rad: npt.ArrayLike,
        velocity_rad_s: npt.ArrayLike | None = None,
        streaming: bool = True,
        interpolation: str = "cubic",
    ) -> None:
        """Publishes a horizon: t_ns (n,) CLOCK_MONOTONIC, position_rad (n, joints), velocity likewise or None."""
        if interpolation not in _wire.Interpolation.__members__:
            raise BadPlan(f"interpolation is {' or '.join(_wire.Interpolation.__members__)}, not {interpolation!r}")
        times = np.asarray(t_ns, dtype=np.int64)
        positions = np.asarray(position_rad, dtype=np.float64)
        if times.ndim != 1 or positions.ndim != 2 or len(times) != len(positions):
            raise BadPlan(f"a plan needs times (n,) and positions (n, joints), not {times.shape} and {positions.shape}")
        if not 1 <= len(times) <= _wire.NW or positions.shape[1] > _wire.NJ:
            raise BadPlan(f"a plan has 1 to {_wire.NW} waypoints of at most {_wire.NJ} joints, not {positions.shape}")
        speeds = np.full(positions.shape, np.nan) if velocity_rad_s is None else np.asarray(velocity_rad_s, np.float64)
        if speeds.shape != positions.shape:
            raise BadPlan(f"a plan needs as many velocities as positions {positions.shape}, not {speeds.shape}")
        count, joints = positions.shape
        with self._publishing:
            self._check_lease()
            plan = self._plan
            plan["plan_id"], plan["waypoint_count"], plan["joint_count"] = plan_id, count, joints
            plan["streaming"] = int(streaming)
            plan["interpolation"] = _wire.Interpolation[interpolation]
            plan["t_ns"][:count] = times
            plan["position_rad"][:count, :joints] = positions
            plan["velocity_rad_s"] = np.nan
            plan["velocity_rad_s"][:count, :joints] = speeds
            shim().lithe_channel_write(self.mapping.item("plan")[1], plan.ctypes.data, plan.dtype.itemsize)
            self.beat()

    def write_inputs(self, values: list[float]) -> None:
        """All inputs of the robot, in its order. The Spine refuses all of them when one is out of range."""
        with self._publishing:
            self._check_lease()
            inputs = np.zeros((), dtype("Inputs"))
            inputs["count"], inputs["value"][: len(values)] = len(values), values
            shim().lithe_channel_write(self.mapping.item("inputs")[1], inputs.ctypes.data, inputs.dtype.itemsize)

    def send(self, letter: npt.NDArray[Any], spine: SpineView) -> int:
        """Puts a Command into the Brain's mailbox; its ticket for SpineView.answer(), 0 while the mailbox is full."""
        item, address = self.mapping.item("commands")
        _, ack = spine.mapping.item("brain_ack")
        with self._publishing:
            self._check_lease()
            return int(shim().lithe_mailbox_send(address, ack, item.depth, letter.ctypes.data, letter.nbytes))

    def press_estop(self, pressed: bool = True) -> None:
        """Sets (or releases) the Brain's sticky e-stop word."""
        self._check_lease()
        shim().lithe_store(self.mapping.item("estop")[1], int(pressed))

    def close(self) -> None:
        """Releases the lease; may be called twice."""
        with self._publishing:
            if self._lock >= 0:
                os.close(self._lock)
                self._lock = -1
