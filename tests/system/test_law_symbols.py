# SPDX-License-Identifier: Apache-2.0
"""gdb is given a law's symbols where the law runs."""

import struct
import subprocess
from pathlib import Path

import law_symbols
import pytest
from system.house import House
from system.swapping import certificates, folder


def test_the_symbols_of_a_law_lie_where_it_runs(arm: House) -> None:
    """Its slot is in the Spine's own map of the arena, and its code is that of its file."""
    placed = certificates(arm)[-1]["placement"]
    path = max(folder(arm).glob("*.json"))
    elf = law_symbols.link(path)
    (entry,) = struct.unpack_from("<Q", elf.read_bytes(), 24)
    maps = Path(f"/proc/{arm.ask('status')['spine_pid']}/maps").read_text(encoding="ascii").splitlines()
    (arena,) = {int(line.split("-")[0], 16) for line in maps if "r-xs" in line and "lithe-arena" in line}
    assert arena == law_symbols.slot_address(1)
    start = law_symbols.slot_address(placed["slot"])
    assert start <= entry < start + placed["code_bytes"], "where the Spine looks for the law's description"
    told = subprocess.run(["addr2line", "-e", elf, hex(start)], check=True, capture_output=True, text=True).stdout
    assert ".cpp:" in told or ".hpp:" in told, told


def test_a_law_whose_object_has_gone_is_named(arm: House, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LITHE_CACHE_DIR", str(arm.dir / "none"))
    with pytest.raises(SystemExit, match="swap the law in again"):
        law_symbols.link(max(folder(arm).glob("*.json")))
