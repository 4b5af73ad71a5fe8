# SPDX-License-Identifier: Apache-2.0
"""Segments without a Spine: what the tests of the Python side read from and write to."""

import ctypes
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
from lithe import _wire, shm


def header(segment: str) -> _wire.SegmentHeader:
    """The header a Spine of this build would write."""
    size = _wire.SEGMENT_BYTES[segment]
    return _wire.SegmentHeader(
        magic=_wire.MAGIC,
        abi_major=_wire.ABI_MAJOR,
        header_bytes=128,
        segment_bytes=size,
        layout_hash=_wire.LAYOUT_HASH,
        schema_offset=size,
        schema_bytes=len(_wire.CANONICAL_SCHEMA),
        created_ns=time.monotonic_ns(),
        heartbeat_ns=time.monotonic_ns(),
        joint_capacity=_wire.NJ,
    )


def make_file(robot: str, segment: str, schema: str = _wire.CANONICAL_SCHEMA, **changes: int) -> Path:
    """An empty segment on /dev/shm; `changes` are written over the header's fields."""
    head = header(segment)
    head.schema_bytes = len(schema)
    for name, value in changes.items():
        setattr(head, name, value)
    path = shm.shm_path(robot, segment)
    with path.open("wb") as file:
        file.write(bytes(head))
        file.truncate(_wire.SEGMENT_BYTES[segment])
        file.seek(_wire.SEGMENT_BYTES[segment])
        file.write(schema.encode())
    return path


def remove(robot: str) -> None:
    """All files of a robot."""
    for segment in _wire.SEGMENTS:
        for path in (shm.shm_path(robot, segment), Path(f"{shm.shm_path(robot, segment)}.lock")):
            path.unlink(missing_ok=True)


class Writer:
    """Writes any item of a segment, through the same shim as the package."""

    def __init__(self, robot: str, segment: str) -> None:
        """Make the file and map it."""
        self.path = make_file(robot, segment)
        self.mapping = shm.Mapping(robot, segment, writable=True)

    def channel(self, name: str, index: int = 0, /, **fields: Any) -> None:
        """Publish a value of a channel."""
        item, address = self.mapping.item(name, index)
        record = self.record(item.message, **fields)
        shm.shim().lithe_channel_write(address, record.ctypes.data, record.nbytes)

    def push(self, name: str, /, **fields: Any) -> None:
        """Append to a ring. Its memory is a mailbox's, so a letter whose receiver is never behind does it."""
        item, address = self.mapping.item(name)
        record = self.record(item.message, **fields)
        never_full = ctypes.c_uint64(shm.shim().lithe_ring_head(address))
        shm.shim().lithe_mailbox_send(
            address, ctypes.addressof(never_full), item.depth, record.ctypes.data, record.nbytes
        )

    def scribble(self, name: str, data: bytes, at: int = 0) -> None:
        """Raw bytes into an item."""
        ctypes.memmove(self.mapping.item(name)[1] + at, data, len(data))

    @staticmethod
    def record(message: str, /, **fields: Any) -> np.ndarray[Any, np.dtype[Any]]:
        """A message with some fields set."""
        record = np.zeros((), shm.dtype(message))
        for field, value in fields.items():
            record[field] = value
        return record


def channel_slots(mapping: shm.Mapping, name: str) -> list[int]:
    """Addresses of the four slots of a channel: each a sequence word, odd while it is written, and the value."""
    item, address = mapping.item(name)
    size = item.stride // 4 // 128 * 128  # the first line holds the index
    return [address + 128 + slot * size for slot in range(4)]


def own_prefix() -> str:
    """A shared-memory prefix nobody else has."""
    return f"t{os.getpid()}-{time.monotonic_ns()}"
