# SPDX-License-Identifier: Apache-2.0
"""What an admitted law can write: nothing that is constant without being stopped, and the list of the rest is true."""

import os
import re
import struct
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest
from calm import calm_text
from lithe._wire import SEGMENTS, SegmentHeader
from system.robot_rig import BIN, ROOT, RobotRig
from system.swapping import law, sway

SOON = "6'000"  # steps: after trial and probation
LATE = """#include <lithe/law.hpp>
struct Late {
  struct Params {};
  struct State { std::uint32_t steps = 0; };
  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j)
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    if (++s.steps == STEPS) *(volatile std::uint64_t*)ADDRESS = 0x4141;
  }
};
LITHE_LAW(Late, "late");
"""
LISTED = re.compile(r"^\| (?P<name>[a-z' ]+?)(?:,.*?|) \| (?P<kib>[\d,]+) KiB \|")
VAULT_KIB = 1024
SENSOR = """
[[device]]
name = "inputs"
kind = "gateway"
bus = "can0"
id = 20
[[sensor]]
name = "grip"
device = "inputs"
kind = "analog"
channel = 0
scale = 12.3456789
"""
ODD = {  # values that are nowhere else in memory
    'kind = "loop" ': 'kind = "loop"\nbitrate = 987654\ndata_bitrate = 4987654 ',
    "recover_velocity_rad_s = 0.3 ": "recover_velocity_rad_s = 0.312345678 ",
    "watchdog_s = 10.0 ": "watchdog_s = 9.87654321 ",
    "deceleration_rad_s2 = 20.0 ": "deceleration_rad_s2 = 20.1234567 ",
}


class Block(NamedTuple):
    """A block of memory that is watched, and something in it: the bytes of a value, or where a segment has them."""

    name: str
    value: bytes = b""
    offset: int = 0


BLOCKS = (
    Block("the robot file's values", struct.pack("<d", 0.312345678)),
    Block("the robot file's values of its joints", struct.pack("<d", 20.1234567)),
    Block("the robot file's values of its devices", struct.pack("<d", 9.87654321)),
    Block("the robot file's values of its buses", struct.pack("<II", 987654, 4987654)),
    Block("the robot file's values of its sensors", struct.pack("<d", 12.3456789)),
    Block("the head of the shared memory", offset=SegmentHeader.created_ns.offset),
    Block("the robot's description in shared memory", offset=SEGMENTS["spine"]["robot_info"].offset + 16),
)
LIBRARY_KIB = 64  # of variables without a file, at most: a stack may happen to lie beside a library


def told(rig: RobotRig, kind: str) -> list[str]:
    """The texts of the events of one kind."""
    return [each["text"] for each in rig.ask("events")["events"] if each["kind"] == kind]


def maps(rig: RobotRig) -> list[tuple[int, int, str, str]]:
    """From, to, rights and name of every piece of the Spine's memory."""
    return maps_of(rig.ask("status")["spine_pid"])


def maps_of(pid: int) -> list[tuple[int, int, str, str]]:
    """Likewise of any process."""
    pieces = []
    for line in Path(f"/proc/{pid}/maps").read_text().splitlines():
        words = line.split(maxsplit=5)
        start, end = (int(word, 16) for word in words[0].split("-"))
        pieces.append((start, end, words[1], words[5] if len(words) == 6 else ""))
    return pieces


def kind_of(name: str, before: str, kib: int) -> str:
    """What a piece is, by its own name or, without one, that of the piece that ends where it begins."""
    for part, kind in {"/dev/shm/": "shared memory", "[heap]": "heap", ".so": "libraries"}.items():
        if part in name or (not name and part in before and kind == "libraries" and kib <= LIBRARY_KIB):
            return kind
    return "the spine's variables" if "lithe-spine" in (name or before) else "stacks"


def writable_kib(rig: RobotRig) -> dict[str, int]:
    """How much of each kind the process may write, the protected memory apart."""
    sizes: dict[str, int] = {}
    end, before = 0, ""
    for start, to, rights, name in maps(rig):
        before = before if start == end and not name else name
        if "w" in rights:
            kib = (to - start) // 1024
            kind = kind_of(name, before, kib)
            sizes[kind] = sizes.get(kind, 0) + kib
        end = to
    sizes["stacks"] -= VAULT_KIB
    return sizes


def test_a_law_that_overwrites_the_spines_variables_is_stopped_there(arm: RobotRig) -> None:
    source = (ROOT / "tests/laws_hostile/overwrites_the_program_delayed.cpp").read_text()
    path = arm.dir / "evening.cpp"
    path.write_text(source.replace("20'000", SOON).replace("the_evening", "a_moment"))
    assert arm.ask("swap", path)["verdict"] == "committed"
    sway(arm, 4.0)
    arm.wait_for(lambda: law(arm) == "pd")
    assert any("bad_access" in text for text in told(arm, "law_faulted"))
    assert arm.ask("swap", ROOT / "laws/gravity_pd.cpp")["verdict"] == "committed"
    assert arm.ask("status")["mode"] == "active"


def test_damage_that_can_only_be_found_stops_the_robot_for_good_and_is_named(arm: RobotRig) -> None:
    (segment,) = [start for start, _, _, name in maps(arm) if name.endswith(".arm.spine")]
    gap = segment + SEGMENTS["spine"]["robot_info"].offset + 16  # between two words that nobody reads
    path = arm.dir / "late.cpp"
    path.write_text(LATE.replace("STEPS", SOON).replace("ADDRESS", hex(gap)))
    assert arm.ask("swap", path)["verdict"] == "committed"
    arm.wait_for(lambda: arm.ask("status")["mode"] == "safe_stop")
    assert arm.ask("status")["fault"] == "memory_damaged"
    assert told(arm, "memory_damaged") == ["memory_damaged: the robot's description in shared memory"]
    for verb in ("arm", "recover"):
        refused = arm.ask(verb, code=3)["error"]
        assert refused["code"] == "refused_damaged"
        assert "lithe run" in refused["next"]
    arm.ask("reset")
    assert arm.ask("arm", code=3)["error"]["code"] == "refused_damaged"
    arm.lithe("stop")
    arm.started[-1].wait(30)
    arm.run()
    arm.wait_for(lambda: arm.ask("status")["mode"] == "active")


def places_of(pid: int, memory: int, block: Block) -> list[int]:
    """Where the block's value is in a process: also in copies and on used pieces of stacks, which nobody checks."""
    if not block.value:
        (segment,) = [start for start, _, _, name in maps_of(pid) if name.endswith(".arm.spine")]
        return [segment + block.offset]
    found = []
    for start, end, _, name in maps_of(pid):
        if name in ("[heap]", "[stack]"):
            held = os.pread(memory, end - start, start)
            found += [start + match.start() for match in re.finditer(re.escape(block.value), held)]
    return found


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.name)
def test_one_bit_of_any_block_that_is_watched_is_noticed_and_the_block_named(rig: RobotRig, block: Block) -> None:
    """In a real Spine, as an error in a driver or a broken memory chip would do it."""
    text = calm_text(ODD)
    rig.config.write_text(text + SENSOR)
    log = rig.dir / "spine.log"
    with (
        log.open("w") as said,
        subprocess.Popen(
            [BIN / "lithe-spine-sim", rig.config], env=rig.env, stdout=subprocess.PIPE, stderr=said, text=True
        ) as spine,
    ):
        assert spine.stdout is not None
        assert '"ready"' in spine.stdout.readline()
        memory = os.open(f"/proc/{spine.pid}/mem", os.O_RDWR)
        places = places_of(spine.pid, memory, block)
        assert places, "the value is not there"
        assert "must not change" not in log.read_text()
        for place in places:
            (byte,) = os.pread(memory, 1, place)
            os.pwrite(memory, bytes([byte ^ 1]), place)
        os.close(memory)
        rig.wait_for(lambda: "must not change" in log.read_text())
        spine.terminate()
    told_by_it = re.findall("memory that must not change has changed: (.*)", log.read_text())
    assert told_by_it == [block.name]


def test_every_block_that_is_watched_is_damaged_here() -> None:
    """The names as the Spine has them."""
    source = (ROOT / "spine/process.cpp").read_text().split("blocks[] = {")[1].split("};")[0]
    assert re.findall(r'\{"(.*?)",', source) == [block.name for block in BLOCKS]


def test_the_list_of_writable_memory_is_true(arm: RobotRig) -> None:
    page = (ROOT / "docs/swap.md").read_text().split("## What is not contained")[1]
    rows = [match for match in map(LISTED.match, page.splitlines()) if match]
    listed = {row["name"].lower(): int(row["kib"].replace(",", "")) for row in rows}
    sizes = writable_kib(arm)
    assert set(sizes) == set(listed), "something can be written that docs/swap.md does not list"
    for name, kib in sizes.items():
        assert listed[name] / 4 <= kib <= listed[name], f"{name}: {kib} KiB"


def test_what_others_write_the_spine_cannot(arm: RobotRig) -> None:
    rights = {Path(name).suffix: rights for _, _, rights, name in maps(arm) if name.startswith("/dev/shm/")}
    assert rights[".control"][1] == rights[".brain"][1] == "-"
    assert rights[".spine"][1] == "w"


def test_it_is_locked_or_the_status_says_why_not(arm: RobotRig) -> None:
    status = arm.ask("status")
    words = Path(f"/proc/{status['spine_pid']}/status").read_text()
    locked_kib = int(words.split("VmLck:")[1].split()[0])
    assert (locked_kib > 0) != ("memory is not locked" in status["lost"]), f"{locked_kib} kB; {status['lost']}"
