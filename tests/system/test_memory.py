# SPDX-License-Identifier: Apache-2.0
"""What an admitted law can write: nothing that is constant without being stopped, and the list of the rest is true."""

import re
from pathlib import Path

from lithe._wire import SEGMENTS
from system.house import ROOT, House
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
LIBRARY_KIB = 64  # of variables without a file, at most: a stack may happen to lie beside a library


def told(house: House, kind: str) -> list[str]:
    """The texts of the events of one kind."""
    return [each["text"] for each in house.ask("events")["events"] if each["kind"] == kind]


def maps(house: House) -> list[tuple[int, int, str, str]]:
    """From, to, rights and name of every piece of the Spine's memory."""
    pieces = []
    for line in Path(f"/proc/{house.ask('status')['spine_pid']}/maps").read_text().splitlines():
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


def writable_kib(house: House) -> dict[str, int]:
    """How much of each kind the process may write, the protected memory apart."""
    sizes: dict[str, int] = {}
    end, before = 0, ""
    for start, to, rights, name in maps(house):
        before = before if start == end and not name else name
        if "w" in rights:
            kib = (to - start) // 1024
            kind = kind_of(name, before, kib)
            sizes[kind] = sizes.get(kind, 0) + kib
        end = to
    sizes["stacks"] -= VAULT_KIB
    return sizes


def test_a_law_that_overwrites_the_spines_variables_is_stopped_there(arm: House) -> None:
    source = (ROOT / "tests/laws_hostile/overwrites_the_program_delayed.cpp").read_text()
    path = arm.dir / "evening.cpp"
    path.write_text(source.replace("20'000", SOON).replace("the_evening", "a_moment"))
    assert arm.ask("swap", path)["verdict"] == "committed"
    sway(arm, 4.0)
    arm.wait_for(lambda: law(arm) == "pd")
    assert any("bad_access" in text for text in told(arm, "law_faulted"))
    assert arm.ask("swap", ROOT / "laws/gravity_pd.cpp")["verdict"] == "committed"
    assert arm.ask("status")["mode"] == "active"


def test_damage_that_can_only_be_found_stops_the_robot_for_good_and_is_named(arm: House) -> None:
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


def test_the_list_of_writable_memory_is_true(arm: House) -> None:
    page = (ROOT / "docs/swap.md").read_text().split("## What is not contained")[1]
    rows = [match for match in map(LISTED.match, page.splitlines()) if match]
    listed = {row["name"].lower(): int(row["kib"].replace(",", "")) for row in rows}
    sizes = writable_kib(arm)
    assert set(sizes) == set(listed), "something can be written that docs/swap.md does not list"
    for name, kib in sizes.items():
        assert listed[name] / 4 <= kib <= listed[name], f"{name}: {kib} KiB"


def test_what_others_write_the_spine_cannot(arm: House) -> None:
    rights = {Path(name).suffix: rights for _, _, rights, name in maps(arm) if name.startswith("/dev/shm/")}
    assert rights[".control"][1] == rights[".brain"][1] == "-"
    assert rights[".spine"][1] == "w"
