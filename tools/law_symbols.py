# SPDX-License-Identifier: Apache-2.0
"""Symbols for gdb of a law that runs in the code arena: its cached object, linked for the slot in its certificate.

`python tools/law_symbols.py` takes the law that runs, or the one of `out/arm/swaps/0001.json`. It writes 0001.elf
beside the certificate and prints gdb's command. The script is lawd's own (lawd/object/link.cpp): the law's addresses
are those at which it runs. Functions of the arena that it calls (sin) get the address of its slot.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SECTIONS = """ENTRY(lithe_law)
SECTIONS {{
  . = {address:#x};
  .text : {{ *(.text .text.*) }}
  .rodata : {{ *(.rodata .rodata.*) *(.data.rel.ro .data.rel.ro.*) *(.got .got.plt) }}
  /DISCARD/ : {{ *(.comment .note .note.* .eh_frame .eh_frame_hdr .gnu.*) }}
}}
"""
LITHE = Path(os.environ.get("LITHE_BIN_DIR") or ROOT / "build/release/bin") / "lithe"


def slot_address(slot: int) -> int:
    """Where a slot begins, as spine/arena/layout.hpp has it: its first base is that of AddressSanitizer."""
    text = (ROOT / "spine/arena/layout.hpp").read_text(encoding="utf-8")
    bases = [int(base.replace("'", ""), 16) for base in re.findall(r"kBase = (0x[\dA-Fa-f']+);", text)]
    size = re.search(r"kSlotBytes = (\d+)u << 10;", text)
    assert len(bases) == 2 and size, "spine/arena/layout.hpp is no longer as this tool reads it"
    return bases[1] + (slot - 1) * int(size[1]) * 1024


def cache() -> Path:
    """Where lawd keeps compiled laws (docs/reference/environment.md)."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get("LITHE_CACHE_DIR") or Path(home) / "lithe") / "laws"


def link(certificate: Path) -> Path:
    """The file with the symbols, beside the certificate."""
    told = json.loads(certificate.read_text(encoding="utf-8"))
    slot = told.get("placement", {}).get("slot", 0)
    if "commit_tick" not in told:
        sys.exit(f"{certificate}: this law never ran ({told.get('verdict')})")
    if not slot:
        sys.exit(f"{certificate}: this law is in no slot of the arena, but in a shared object that gdb knows by itself")
    object_file = cache() / f"{told['hash']}.o"
    if not object_file.exists():
        sys.exit(f"{object_file} is not there: swap the law in again, or set LITHE_CACHE_DIR as lithe run has it")
    elf = certificate.with_suffix(".elf")
    with tempfile.NamedTemporaryFile("w", suffix=".ld") as script:
        listed = subprocess.run(["nm", "-u", object_file], check=True, capture_output=True, text=True).stdout
        outside = [f"PROVIDE({line.split()[-1]} = {slot_address(slot):#x});" for line in listed.splitlines()]
        script.write("\n".join([SECTIONS.format(address=slot_address(slot)), *outside]))
        script.flush()
        words = ["ld", "-static", "-nostdlib", "-N", "--no-warn-rwx-segments"]
        subprocess.run([*words, "-T", script.name, object_file, "-o", elf], check=True)
    return elf


def running() -> Path:
    """The certificate of the law that the only running robot runs."""
    asked = subprocess.run([LITHE, "--json", "status"], check=False, capture_output=True, text=True)
    if asked.returncode != 0:
        sys.exit(asked.stderr or asked.stdout)
    status = json.loads(asked.stdout)
    for path in sorted(Path(status["records"]).glob("[0-9]*.json"), reverse=True):
        if json.loads(path.read_text(encoding="utf-8")).get("law_id") == status["law_id"]:
            return path
    sys.exit(f"{status['records']} has no certificate of law {status['law_id']}, which runs")


def main() -> int:
    """One certificate."""
    if len(sys.argv) > 2 or (sys.argv[1:] and not Path(sys.argv[1]).is_file()):
        sys.exit(
            "usage: law_symbols.py [out/ROBOT/swaps/NUMBER.json]; without a file, of the law that the only robot runs"
        )
    print(f"add-symbol-file {link(Path(sys.argv[1]) if sys.argv[1:] else running())}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
