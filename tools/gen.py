#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Turns schema/wire.toml into everything that shares its layout.

python3 tools/gen.py --write   writes the generated files
python3 tools/gen.py --check   exits 1 and names each file that is stale
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

from wiregen import cpp, docs, python
from wiregen.schema import LINE, RECORD_ALIGN, Schema, SchemaError, load

ROOT = Path(__file__).resolve().parent.parent
SHIM = "brain/lithe/_shm/lithe_shm.c"


def with_layout(text: str, schema: Schema) -> str:
    """The C side of Python with the numbers of this schema."""
    layout_hash = f"UINT64_C(0x{schema.layout_hash():016x})"
    for name, value in (("LINE", LINE), ("RECORD_ALIGN", RECORD_ALIGN), ("LAYOUT_HASH", layout_hash)):
        text, found = re.subn(rf"^(#define LITHE_{name}) .*", rf"\1 {value}", text, flags=re.M)
        if found != 1:
            raise SchemaError(f"{SHIM} has {found} lines #define LITHE_{name}; it must have one")
    return text


def outputs(root: Path, schema_path: Path) -> dict[Path, str]:
    """Every generated file and what it should hold."""
    schema = load(schema_path)
    files = {
        root / "spine/wire/wire.hpp": cpp.emit(schema),
        root / "spine/wire/fields.hpp": cpp.emit_fields(schema),
        root / "brain/lithe/_wire.py": python.emit(schema),
        root / SHIM: with_layout((ROOT / SHIM).read_text(encoding="utf-8"), schema),
        root / "docs/reference/wire.md": docs.reference(schema),
    }
    for message in schema.messages.values():
        files[root / f"schema/msg/{message.name}.msg"] = docs.msg(message)
    return files


def stale(files: dict[Path, str], root: Path) -> list[Path]:
    """Files that are absent, old, or left over from a message that is gone."""
    old = [path for path, text in files.items() if not path.exists() or path.read_text(encoding="utf-8") != text]
    return old + [path for path in sorted((root / "schema/msg").glob("*.msg")) if path not in files]


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    mode = parser.add_mutually_exclusive_group(required=True)
    mode.add_argument("--write", action="store_true", help="write the generated files")
    mode.add_argument("--check", action="store_true", help="exit 1 if a generated file is stale")
    parser.add_argument("--schema", type=Path, default=ROOT / "schema/wire.toml")
    parser.add_argument("--root", type=Path, default=ROOT, help="where the files go")
    args = parser.parse_args(argv)
    try:
        files = outputs(args.root, args.schema)
    except (SchemaError, OSError) as error:
        print(f"gen.py: {error}", file=sys.stderr)
        return 1
    old = stale(files, args.root)
    if args.write:
        for path in old:
            if path not in files:
                path.unlink()
                print(f"removed {path.relative_to(args.root)}")
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(files[path], encoding="utf-8")
            print(f"wrote {path.relative_to(args.root)}")
        return 0
    for path in old:
        print(f"gen.py: {path.relative_to(args.root)} is stale: run `python3 tools/gen.py --write`", file=sys.stderr)
    return 1 if old else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
