# SPDX-License-Identifier: Apache-2.0
"""The gateway's token, and the file that its clients read it from."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import hmac
import os
import secrets
import stat
from pathlib import Path

from ..control import run_dir
from ..errors import LitheError
from ..files import own_folder
from ..vocabulary import Tier

_HELD: dict[Path, int] = {}  # token files of this process, open and locked


def new_token() -> str:
    """A random token."""
    return secrets.token_hex(16)


def lower(token: str, tier: Tier) -> str:
    """A token for that tier, made from one of a higher tier; from it nobody finds the higher one."""
    return f"{tier.name}-{hmac.new(token.encode(), tier.name.encode(), hashlib.sha256).hexdigest()[:32]}"


def write_token(path: Path, token: str | None = None) -> str:
    """A token, a fresh one if none is given, in a file that only its owner can read; LitheError if a gateway uses it.

    The file stays locked until this process ends, so that another gateway detects that it is in use.
    """
    token = token or new_token()
    if path.parent == run_dir():
        own_folder(path.parent, "LITHE_RUN_DIR")
    path.parent.mkdir(mode=0o750, parents=True, exist_ok=True)
    with contextlib.suppress(FileNotFoundError):
        before = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        try:
            fcntl.flock(before, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if path not in _HELD:
                raise LitheError(
                    f"another gateway's clients read their token from {path}\n  next: --token-file with another name"
                ) from None
        else:
            if os.fstat(before).st_mode != stat.S_IFREG | 0o600:  # those that we write are for their owner alone
                raise LitheError(
                    f"{path} is there, and is no token file (mode 0600): it is left as it is\n"
                    "  next: --token-file with another name"
                )
        finally:
            os.close(before)
        path.unlink()
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    fcntl.flock(fd, fcntl.LOCK_EX)
    os.write(fd, token.encode() + b"\n")
    if path in _HELD:
        os.close(_HELD[path])
    _HELD[path] = fd
    return token
