# SPDX-License-Identifier: Apache-2.0
"""Certificates of swaps, held against the chain that binds them. The checking itself is `lithe law verify`."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

from .errors import LitheError
from .programs import binary


@dataclass(frozen=True)
class Problem:
    """One thing that is not as it was written.

    `what` is changed, missing, extra or order; `file` the certificate's name, `line` that of the chain (0: none);
    `text` a sentence.
    """

    what: str
    file: str
    line: int
    text: str


@dataclass(frozen=True)
class Chain:
    """What verify() found: how many certificates the chain names, how often one was written, what is wrong.

    `cut` counts writings that a full disk or a crash cut short: no problem, but worth a look.
    """

    folder: Path
    certificates: int
    writings: int
    cut: int
    problems: tuple[Problem, ...]

    @property
    def holds(self) -> bool:
        """True if nothing was changed, removed, added or reordered."""
        return not self.problems

    @property
    def broken(self) -> frozenset[str]:
        """Names of the certificates that a problem is about; the others are what was written."""
        return frozenset(each.file for each in self.problems)


def verify(folder: str | Path) -> Chain:
    """Holds all certificates of a folder (`out/<robot>/swaps`) against their chain; no robot needs to run.

    The chain shows what was changed later by somebody who did not write it anew: it is not a signature. Certificates
    that were cut off at its end, lines and files alike, are not missed. Raises LitheError where there are none.
    """
    command = [str(binary("lithe")), "--json", "law", "verify", "--folder", str(folder)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    try:
        told = json.loads(done.stdout)
    except ValueError:
        raise LitheError(f"lithe law verify did not answer: {done.stdout}{done.stderr}") from None
    if "error" in told:
        raise LitheError(f"{told['error']['message']}\n  next: {told['error']['next']}")
    problems = tuple(Problem(**each) for each in told["problems"])
    return Chain(Path(told["folder"]), told["certificates"], told["writings"], told["cut"], problems)
