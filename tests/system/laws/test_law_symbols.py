# SPDX-License-Identifier: Apache-2.0
"""gdb is given a law's symbols where the law runs."""

import struct
import subprocess
import sys
from pathlib import Path

import law_symbols
import pytest
from system.robot_rig import ROOT, RobotRig
from system.swapping import certificates, folder


def test_the_symbols_of_a_law_lie_where_it_runs(arm: RobotRig) -> None:
    """Its slot is in the Spine's own map of the arena, and its code is that of its file."""
    placed = certificates(arm)[-1]["placement"]
    path = max(folder(arm).glob("[0-9]*.json"))
    elf = law_symbols.link(path)
    (entry,) = struct.unpack_from("<Q", elf.read_bytes(), 24)
    maps = Path(f"/proc/{arm.ask('status')['spine_pid']}/maps").read_text(encoding="ascii").splitlines()
    (arena,) = {int(line.split("-")[0], 16) for line in maps if "r-xs" in line and "lithe-arena" in line}
    assert arena == law_symbols.slot_address(1)
    start = law_symbols.slot_address(placed["slot"])
    assert start <= entry < start + placed["code_bytes"], "where the Spine looks for the law's description"
    told = subprocess.run(["addr2line", "-e", elf, hex(start)], check=True, capture_output=True, text=True).stdout
    assert ".cpp:" in told or ".hpp:" in told, told


@pytest.mark.parametrize("law", sorted((ROOT / "laws").glob("*.cpp")), ids=lambda law: law.stem)
def test_every_law_that_comes_with_lithe_can_be_looked_into(arm: RobotRig, law: Path) -> None:
    """Also those that call functions of the arena."""
    done = arm.ask("swap", law)
    elf = law_symbols.link(folder(arm) / done["certificate"])
    start = law_symbols.slot_address(done["placement"]["slot"])
    told = subprocess.run(["addr2line", "-e", elf, hex(start)], check=True, capture_output=True, text=True).stdout
    assert ".cpp:" in told or ".hpp:" in told, told


def test_without_a_certificate_it_is_the_law_that_runs(arm: RobotRig, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not the newest certificate: that one may be of a law that was refused."""
    for key, value in arm.env.items():
        monkeypatch.setenv(key, value)
    runs = folder(arm) / arm.ask("swap", "pd")["certificate"]
    refused = arm.dir / "refused.cpp"
    refused.write_text("int x;")
    arm.ask("swap", refused, code=1)
    assert law_symbols.running() == runs
    with pytest.raises(SystemExit, match="never ran"):
        law_symbols.link(max(folder(arm).glob("[0-9]*.json")))


def test_a_core_dump_has_the_arena(arm: RobotRig) -> None:
    """It is a private mapping of a file to the kernel, which core dumps leave out if nobody asks for it (core(5))."""
    spine = arm.ask("status")["spine_pid"]
    assert int(Path(f"/proc/{spine}/coredump_filter").read_text(encoding="ascii"), 16) & 4


def test_a_law_whose_object_has_gone_is_named(arm: RobotRig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LITHE_CACHE_DIR", str(arm.dir / "none"))
    with pytest.raises(SystemExit, match="swap the law in again"):
        law_symbols.link(folder(arm) / "0001.json")


@pytest.mark.parametrize("words", [["--help"], ["out/arm/swaps/9999.json"], ["a", "b"]])
def test_anything_but_one_certificate_is_answered_with_the_usage(
    words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["law_symbols.py", *words])
    with pytest.raises(SystemExit, match=r"usage: law_symbols\.py \[out/ROBOT/swaps/NUMBER\.json\]"):
        law_symbols.main()
