# SPDX-License-Identifier: Apache-2.0
"""Symbols for gdb of a law that runs in the code arena: its cached object, linked for the slot in its certificate.

`python tools/law_symbols.py out/arm/swaps/0001.json` writes 0001.elf beside it and prints gdb's command. The script is
lawd's own (lawd/object/place.cpp), so that every address is the one at which the law runs.
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
    if not slot:
        sys.exit(f"{certificate}: this law is in no slot of the arena, but in a shared object that gdb knows by itself")
    object_file = cache() / f"{told['hash']}.o"
    if not object_file.exists():
        sys.exit(f"{object_file} is not there: swap the law in again, or set LITHE_CACHE_DIR as lithe run has it")
    elf = certificate.with_suffix(".elf")
    with tempfile.NamedTemporaryFile("w", suffix=".ld") as script:
        script.write(SECTIONS.format(address=slot_address(slot)))
        script.flush()
        words = ["ld", "-static", "-nostdlib", "-N", "--no-warn-rwx-segments", "--unresolved-symbols=ignore-all"]
        subprocess.run([*words, "-T", script.name, object_file, "-o", elf], check=True)
    return elf


def main() -> int:
    """One certificate."""
    if len(sys.argv) != 2:
        sys.exit("usage: law_symbols.py out/ROBOT/swaps/NUMBER.json")
    print(f"add-symbol-file {link(Path(sys.argv[1]))}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
