# SPDX-License-Identifier: Apache-2.0
"""Finds the programs that belong to this package."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from .errors import LitheError

ROOT = Path(__file__).resolve().parents[2]


def binary(name: str) -> Path:
    """$LITHE_BIN_DIR, else build/release/bin of this tree; `lithe` itself also where the shell finds it."""
    path = Path(os.environ.get("LITHE_BIN_DIR") or ROOT / "build/release/bin") / name
    if path.exists():
        return path
    if name == "lithe" and (found := shutil.which(name)):
        return Path(found)
    raise LitheError(f"{path} is not built\n  next: make release")
