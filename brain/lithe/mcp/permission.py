# SPDX-License-Identifier: Apache-2.0
"""A person's permission to change the robot, for a time: a small file that an agent behind MCP cannot write.

What stops the robot never needs it.
"""

from __future__ import annotations

import json
import math
import os
import time
from pathlib import Path

from ..control import run_dir
from ..errors import LitheError
from ..files import own_folder
from ..vocabulary import Tier

MOST_MINUTES = 24 * 60.0


def path_of(port: int) -> Path:
    """The file of one gateway's port."""
    return run_dir() / f"mcp-{port}.may-move"


def give(file: Path, minutes: float, tier: Tier = Tier.move) -> float:
    """Writes the permission (mode 0600): what `tier` says; returns the time of its end, in seconds since 1970."""
    if not 0 < minutes <= MOST_MINUTES:
        raise LitheError(f"{minutes:g} minutes are not between 0 and {MOST_MINUTES:g}\n  next: give fewer minutes")
    until_s = time.time() + 60 * minutes
    own_folder(file.parent, "LITHE_RUN_DIR")
    draft = file.with_name(f"{file.name}.{os.getpid()}")
    with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o600), "w") as out:
        json.dump({"until_unix_s": until_s, "tier": tier.name}, out)
    draft.replace(file)
    return until_s


def take_back(file: Path) -> None:
    """From now on nothing is changed."""
    file.unlink(missing_ok=True)


def tier_in(file: Path) -> Tier:
    """What it permits; observe: nothing. A file that is not ours, or is damaged, or whose time is over, is none."""
    try:
        with os.fdopen(os.open(file, os.O_RDONLY | os.O_NOFOLLOW), encoding="utf-8") as given:
            found = os.fstat(given.fileno())
            if found.st_uid != os.getuid() or found.st_mode & 0o077:
                return Tier.observe
            told = json.loads(given.read())
        left_s, tier = float(told["until_unix_s"]) - time.time(), Tier[told["tier"]]
    except (OSError, ValueError, KeyError, TypeError):
        return Tier.observe
    # A clock that was set back must not make it longer than it can be.
    return tier if math.isfinite(left_s) and 0 < left_s <= 60 * MOST_MINUTES else Tier.observe
