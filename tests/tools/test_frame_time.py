# SPDX-License-Identifier: Apache-2.0
"""The bit counter behind `lithe bus plan` against an oracle built another way, bit for bit."""

import random
import subprocess
from collections.abc import Callable, Iterator

import pytest
from can_oracle import CRC15, CRC17, CRC21, FD_SIZES, CanFrame, OnWire, checksum, fenced, on_wire, stuffed
from system.robot_rig import BIN, need

FRAMES = 10_000


def payload(dice: random.Random, size: int) -> bytes:
    """Any bytes, long runs, or few ones: what needs no, all and some stuff bits."""
    kind = dice.randrange(5)
    if kind == 0:
        return bytes(dice.choice((0x00, 0xFF)) for _ in range(size))
    if kind == 1:
        return bytes(dice.choice((0x0F, 0x87, 0xC3, 0xE1, 0xF0)) for _ in range(size))
    if kind == 2:
        return bytes(1 << dice.randrange(8) for _ in range(size))
    return dice.randbytes(size)


def frames(count: int, seed: int = 1) -> Iterator[CanFrame]:
    """Frames of every kind and length."""
    dice = random.Random(seed)
    for _ in range(count):
        extended, fd = dice.random() < 0.5, dice.random() < 0.7
        bits = 29 if extended else 11
        number = dice.getrandbits(bits) if dice.random() < 0.7 else dice.choice((0, 1, 0x8001, 0x700, (1 << bits) - 1))
        size = dice.choice(FD_SIZES) if fd else dice.randrange(9)
        yield CanFrame(number & ((1 << bits) - 1), extended, fd, fd and dice.random() < 0.7, payload(dice, size))


@pytest.fixture(scope="module")
def counted() -> list[tuple[CanFrame, OnWire, OnWire, OnWire]]:
    """Each frame with what LITHE says of it: on the wire, at least, at most."""
    need("frame_time_peer")
    asked = list(frames(FRAMES))
    lines = "".join(
        f"{each.id:x} {each.extended:d} {each.fd:d} {each.brs:d} {each.data.hex() or '-'}\n" for each in asked
    )
    done = subprocess.run([BIN / "frame_time_peer"], input=lines, capture_output=True, text=True, check=True)
    answers = []
    for frame, line in zip(asked, done.stdout.splitlines(), strict=True):
        bits, *numbers = line.split()
        exact, least, most = (OnWire(bits, int(numbers[at]), int(numbers[at + 1])) for at in (0, 2, 4))
        answers.append((frame, exact, least, most))
    return answers


Counted = list[tuple[CanFrame, OnWire, OnWire, OnWire]]


def total(wire: OnWire) -> int:
    """All bits, whatever their rate."""
    return wire.nominal + wire.data


def test_ten_thousand_frames_are_the_same_bits_at_the_same_rates(counted: Counted, tell: Callable[[str], None]) -> None:
    """Levels, stuff bits, stuff count and CRC; slow and fast bits."""
    assert [(frame, exact) for frame, exact, _, _ in counted if exact != on_wire(frame)] == []
    tell(f"{len(counted)} frames, {sum(len(exact.bits) for _, exact, _, _ in counted)} bits: all equal")


def closed_form(frame: CanFrame) -> tuple[int, int, int]:
    """Bits without stuffing, bits that the stuffing covers, of these the slow ones; one line per kind, from the field
    lengths alone."""
    n = 8 * len(frame.data)
    if not frame.fd:
        head = 54 if frame.extended else 34
        return head + n + 13, head + n, head + n
    slow = 36 if frame.extended else 17
    return slow + 13 + 5 + n + (27 if n <= 128 else 32), slow + 5 + n, slow


def test_the_closed_form_is_within_a_bit_and_the_bounds_hold(counted: Counted, tell: Callable[[str], None]) -> None:
    """Length = fields + stuff bits, these counted on the covered bits; at most (covered - 1) / 4 of them."""
    off, closest = 0, 1 << 30
    for frame, exact, least, most in counted:
        plain, covered, slow = closed_form(frame)
        assert total(least) == plain
        assert total(most) == plain + (covered - 1) // 4
        assert most.nominal - least.nominal <= ((slow if frame.brs else covered) - 1) // 4
        assert least.nominal <= exact.nominal <= most.nominal
        assert total(least) <= total(exact) <= total(most)
        closest = min(closest, total(most) - total(exact))
        if frame.fd:
            taken = plain + len(stuffed("".join(unstuffed(exact.bits, covered)))) - covered
            off = max(off, abs(taken - total(exact)))
    assert off <= 1
    assert closest <= 6, "no frame came near the bound: it says little, or the frames do"
    tell(f"closed form off by {off} bit at most; the longest frame is {closest} bits below its bound")


def unstuffed(bits: str, covered: int) -> Iterator[str]:
    """The first bits without the stuff bits between them: a receiver's view."""
    run, last, taken = 0, "", 0
    for bit in bits:
        if run == 5:
            run, last = 1, bit
            continue
        run, last, taken = (run + 1 if bit == last else 1), bit, taken + 1
        yield bit
        if taken == covered:
            return


def test_an_oracle_without_the_stuff_count_is_noticed(counted: Counted) -> None:
    """A twin that draws CAN FD as it was before ISO 11898-1:2015: every FD frame differs, no other."""
    wrong = {frame for frame, exact, _, _ in counted if exact != on_wire(frame, stuff_count=False)}
    assert wrong == {frame for frame, _, _, _ in counted if frame.fd}


def test_the_oracle_itself_knows_the_published_check_values() -> None:
    """CRC-15/CAN, CRC-17/CAN-FD and CRC-21/CAN-FD of "123456789"; stuffing and fence by hand."""
    digits = "".join(f"{byte:08b}" for byte in b"123456789")
    assert int(checksum(digits, CRC15), 2) == 0x059E
    assert int(checksum(digits, CRC17), 2) == 0x04F03
    assert int(checksum(digits, CRC21), 2) == 0x0ED841
    assert stuffed("0000011110") == "000001111100"
    assert stuffed("00000000000") == "0000010000010"
    assert stuffed("1111100001") == "111110000011"
    assert fenced("000011110", "0") == "10000" + "11111" + "00"
