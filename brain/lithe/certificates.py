# SPDX-License-Identifier: Apache-2.0
"""Verifies certificates of swaps against their chain. The check itself is `lithe law verify`."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

from .errors import LitheError
from .programs import binary


@dataclass(frozen=True)
class Problem:
    """One problem of a chain.

    `what` is changed, missing, extra or order; `file` the certificate's name, `line` that of the chain (0: none);
    `text` a sentence.
    """

    what: str
    file: str
    line: int
    text: str


@dataclass(frozen=True)
class Chain:
    """Result of verify(): number of certificates in the chain, number of writings, problems.

    `cut` counts writings that a full disk or a crash interrupted: not a problem, but worth checking.
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
        """Names of the certificates with a problem; the others are unchanged."""
        return frozenset(each.file for each in self.problems)


def verify(folder: str | Path) -> Chain:
    """Checks all certificates of a folder (`out/<robot>/swaps`) against their chain; no robot needs to run.

    The chain detects later changes, unless the whole chain was rewritten: it is not a signature. Certificates
    removed at its end together with their lines are not detected. Raises LitheError where there are none.
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
