# SPDX-License-Identifier: Apache-2.0
"""A CAN frame as text of 0 and 1, from the standard's drawings: what the planner's bit counter is held against.

Nothing here walks along bits as a controller does: stuffing works on runs of equal bits, a CRC is one division of whole
numbers.
"""

import itertools
from dataclasses import dataclass

FD_SIZES = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
CRC15, CRC17, CRC21 = 0xC599, 0x3685B, 0x302899  # with their highest power
DELIMITER, ACKNOWLEDGED, END = "1", "01", "1" * 7 + "1" * 3


@dataclass(frozen=True)
class CanFrame:
    """Any frame a bus may carry; data of a length that exists."""

    id: int
    extended: bool
    fd: bool
    brs: bool
    data: bytes


@dataclass(frozen=True)
class OnWire:
    """Levels in order, and how many of them pass at the slow and at the fast rate."""

    bits: str
    nominal: int
    data: int


def other(bit: str) -> str:
    """The opposite level."""
    return "10"[int(bit)]


def stuffed(bits: str) -> str:
    """Five equal bits are followed by an opposite one, which is the first of the run behind it."""
    pieces: list[str] = []
    room = 5
    for level, group in itertools.groupby(bits):
        run = len(list(group))
        while run >= room:
            pieces.append(level * room + other(level))
            run -= room
            room = 5
            if run == 0:
                room = 4  # of the next run, the stuff bit is one already
                break
        else:
            pieces.append(level * run)
            room = 5
    return "".join(pieces)


def remainder(number: int, polynomial: int) -> int:
    """What division of polynomials over 0 and 1 leaves."""
    degree = polynomial.bit_length() - 1
    while (over := number.bit_length() - 1 - degree) >= 0:
        number ^= polynomial << over
    return number


def checksum(bits: str, polynomial: int, first_one: bool = False) -> str:
    """The CRC of these bits; with `first_one`, of a register that starts with a one on top."""
    width = polynomial.bit_length() - 1
    number = int(bits, 2) << width
    if first_one:
        number ^= 1 << (width - 1 + len(bits))
    return f"{remainder(number, polynomial):0{width}b}"


def fenced(bits: str, before: str) -> str:
    """With a fixed stuff bit in front and behind every four: the opposite of the bit it follows."""
    fours = [bits[at : at + 4] for at in range(0, len(bits), 4)]
    lasts = [before, *(four[-1] for four in fours)]
    return "".join(other(last) + four for last, four in zip(lasts, fours, strict=False))


def identifier(frame: CanFrame) -> str:
    """Start of frame, identifier, and what tells its kind, up to where classic CAN and CAN FD part."""
    if frame.extended:
        whole = f"{frame.id:029b}"
        return f"0{whole[:11]}11{whole[11:]}0"
    return f"0{frame.id:011b}00"


def classic(frame: CanFrame) -> OnWire:
    """All at one rate, all stuffed, the CRC as well."""
    reserved = "00" if frame.extended else "0"
    payload = "".join(f"{byte:08b}" for byte in frame.data)
    covered = f"{identifier(frame)}{reserved}{len(frame.data):04b}{payload}"
    bits = stuffed(covered + checksum(covered, CRC15)) + DELIMITER + ACKNOWLEDGED + END
    return OnWire(bits, len(bits), 0)


def flexible(frame: CanFrame, stuff_count: bool = True) -> OnWire:
    """Stuffed up to the data's end; its CRC sees the stuff bits, and is fenced. `stuff_count` is false in a twin."""
    slow = f"{identifier(frame)}10{int(frame.brs)}"
    payload = "".join(f"{byte:08b}" for byte in frame.data)
    plain = f"{slow}0{FD_SIZES.index(len(frame.data)):04b}{payload}"
    whole = stuffed(plain)
    if whole[-1] != plain[-1]:
        whole = whole[:-1]  # a stuff bit behind the last bit of data: the fence's first stands there anyway
    count = (len(whole) - len(plain)) % 8
    gray = f"{count ^ count >> 1:03b}"
    counted = gray + str(gray.count("1") % 2) if stuff_count else ""
    crc = checksum(whole + counted, CRC17 if len(frame.data) <= 16 else CRC21, first_one=True)
    fast = whole[len(stuffed(slow)) :] + fenced(counted + crc, whole[-1])
    bits = stuffed(slow) + fast + DELIMITER + ACKNOWLEDGED + END
    return OnWire(bits, len(bits) - len(fast), len(fast)) if frame.brs else OnWire(bits, len(bits), 0)


def on_wire(frame: CanFrame, stuff_count: bool = True) -> OnWire:
    """Any frame."""
    return flexible(frame, stuff_count) if frame.fd else classic(frame)
