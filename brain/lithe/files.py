# SPDX-License-Identifier: Apache-2.0
"""Reads text files with names from users, with a limit, and the text of a robot file; folders only we may write."""

from __future__ import annotations

import os
import stat
import tomllib
from pathlib import Path
from typing import Any

from .errors import LitheError

MOST_BYTES = 1 << 20


def read_regular(path: str | Path, most_bytes: int = MOST_BYTES) -> str:
    """The text of a regular file; OSError for a folder, a device, a pipe, or a file that is larger; ValueError when it
    is no UTF-8. Never waits and never reads without end (/dev/zero)."""
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOCTTY)
    try:
        mode = os.fstat(fd).st_mode
        if stat.S_ISDIR(mode):
            raise OSError(0, "is a directory, not a file", str(path))
        if not stat.S_ISREG(mode):
            raise OSError(0, "is a device, a pipe or a socket, not a file", str(path))
        with os.fdopen(os.dup(fd), "rb") as file:
            data = file.read(most_bytes + 1)
    finally:
        os.close(fd)
    if len(data) > most_bytes:
        raise OSError(0, f"is larger than {most_bytes} bytes", str(path))
    return data.decode("utf-8")


def own_folder(path: Path, variable: str) -> Path:
    """The folder, made when it is absent. LitheError when others could put files there, or replace it: it is no real
    directory, belongs neither to this user nor to root, or is open to everybody; `variable` can name another one."""
    try:
        path.mkdir(mode=0o750, parents=True, exist_ok=True)
    except OSError as error:
        raise LitheError(f"cannot create {path}: {error.strerror}\n  next: set {variable} to another folder") from None
    about = path.lstat()
    ours = about.st_uid in (os.geteuid(), 0)
    if not stat.S_ISDIR(about.st_mode) or not ours or about.st_mode & stat.S_IWOTH:
        kind = "a symbolic link" if stat.S_ISLNK(about.st_mode) else "a folder"
        mend = f"chmod o-w {path}" if ours and stat.S_ISDIR(about.st_mode) else "remove it"
        raise LitheError(
            f"{path} is not used: it is {kind} of uid {about.st_uid} (mode {about.st_mode & 0o7777:04o}), and others"
            f" could put files there\n  next: {mend}, or set {variable} to a folder of your own"
        )
    return path


def robot_table(text: str) -> dict[str, Any]:
    """A robot file's text, where each device and each joint has what [defaults] gives to all, and each joint a `sim`.

    ValueError, TypeError or AttributeError where it is none; keys may lack.
    """
    config = tomllib.loads(text)
    defaults = config.get("defaults", {})
    device, joint = defaults.get("device", {}), defaults.get("joint", {})
    sim = joint.get("sim", {})
    if "device" in config:
        config["device"] = [{**device, **own} for own in config["device"]]
    if "joint" in config:
        config["joint"] = [{**joint, **own, "sim": {**sim, **own.get("sim", {})}} for own in config["joint"]]
    return config
