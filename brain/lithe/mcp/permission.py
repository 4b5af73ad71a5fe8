# SPDX-License-Identifier: Apache-2.0
"""A person's permission to move the robot, for a time: a small file that an agent behind MCP cannot write.

What stops the robot, or goes back, never needs it.
"""

from __future__ import annotations

import json
import math
import os
import time
from pathlib import Path

from ..control import run_dir
from ..errors import LitheError

MOST_MINUTES = 24 * 60.0


def path_of(port: int) -> Path:
    """The file of one gateway's port."""
    return run_dir() / f"mcp-{port}.may-move"


def give(file: Path, minutes: float) -> float:
    """Writes the permission (mode 0600); returns the time of its end, in seconds since 1970."""
    if not 0 < minutes <= MOST_MINUTES:
        raise LitheError(f"{minutes:g} minutes are not between 0 and {MOST_MINUTES:g}\n  next: give fewer minutes")
    until_s = time.time() + 60 * minutes
    file.parent.mkdir(parents=True, exist_ok=True)
    draft = file.with_name(f"{file.name}.{os.getpid()}")
    with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o600), "w") as out:
        json.dump({"until_unix_s": until_s}, out)
    draft.replace(file)
    return until_s


def take_back(file: Path) -> None:
    """From now on nothing moves."""
    file.unlink(missing_ok=True)


def remaining_s(file: Path) -> float:
    """Seconds until the permission ends; 0: there is none. A file that is not ours, or is damaged, is none."""
    try:
        with os.fdopen(os.open(file, os.O_RDONLY | os.O_NOFOLLOW), encoding="utf-8") as given:
            told = os.fstat(given.fileno())
            if told.st_uid != os.getuid() or told.st_mode & 0o077:
                return 0.0
            left_s = float(json.loads(given.read())["until_unix_s"]) - time.time()
    except (OSError, ValueError, KeyError, TypeError):
        return 0.0
    # A clock that was set back must not make it longer than it can be.
    return left_s if math.isfinite(left_s) and 0 < left_s <= 60 * MOST_MINUTES else 0.0
