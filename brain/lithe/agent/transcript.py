# SPDX-License-Identifier: Apache-2.0
"""What an agent said and got: JSON lines, each with the SHA-256 of the line before, so that a change is detected.

Like the chain of certificates it is not a signature: who rewrites all lines is not detected.
"""

from __future__ import annotations

import hashlib
import json
import threading
import time
from pathlib import Path
from typing import Any

from ..control import plain


class Transcript:
    """Appends to `folder`/transcript.jsonl. Any thread. OSError: it cannot be written; nobody continues unseen."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self._lock, self._before, self._count = folder, threading.Lock(), "", 0
        self._file = (folder / "transcript.jsonl").open("xb")

    def add(self, kind: str, /, **what: Any) -> None:
        with self._lock:
            self._count += 1
            head = {"n": self._count, "at": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()), "before": self._before}
            line = json.dumps({**head, "kind": kind, **what}, default=plain).encode()
            self._before = hashlib.sha256(line).hexdigest()
            self._file.write(line + b"\n")
            self._file.flush()

    def keep(self, name: str, text: str) -> str:
        """A file beside it, such as a law; its SHA-256."""
        data = text.encode("utf-8", "replace")
        path = self.folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
        return hashlib.sha256(data).hexdigest()

    def close(self) -> None:
        self._file.close()


def broken_at(path: Path) -> int | None:
    """The number of the first line that does not follow from the one before; None when all do."""
    before = ""
    for number, line in enumerate(path.read_bytes().splitlines(), 1):
        try:
            one = json.loads(line)
        except ValueError:
            return number
        if not isinstance(one, dict) or one.get("before") != before or one.get("n") != number:
            return number
        before = hashlib.sha256(line).hexdigest()
    return None
