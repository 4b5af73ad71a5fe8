# SPDX-License-Identifier: Apache-2.0
"""Certificates of swaps: waits for their verdict (and that of parameters); verifies the chain (`lithe law verify`)."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import LitheError
from .programs import binary

if TYPE_CHECKING:
    from .robot import Robot

PATIENCE_S = 3.0  # a verdict comes so long after the probation at the latest
MOST_WAIT_S = 20.0
LOOK_S = 0.1


def _is_known(certificate: dict[str, Any]) -> bool:
    """Whether what there is to know of a swap is in its certificate."""
    verdict = certificate.get("verdict")
    if verdict == "rolled_back":
        return "rolled_back" in certificate
    if verdict in ("refused", "not_confirmed", "measured") or "probation" in certificate:  # cut short by another swap
        return True
    without = not (certificate.get("terms") or {}).get("probation_s")
    return "control" in certificate and (verdict in ("confirmed", "unproven") or without)


def with_verdict(robot: Robot, certificate: dict[str, Any], ends: Callable[[], bool] = lambda: False) -> dict[str, Any]:
    """The answer of a swap once its probation has a verdict and the new law was measured: `control`, `rolled_back`.

    Waits for probation_s and PATIENCE_S more, at most MOST_WAIT_S, or until `ends()`. It is as it is by then: a verdict
    that is still `committed` comes later, into the certificate.
    """
    probation_s = float((certificate.get("terms") or {}).get("probation_s") or 0.0)
    until_s = time.monotonic() + min(probation_s + PATIENCE_S, MOST_WAIT_S)
    folder = Path(robot.call("status")["records"])
    while not _is_known(certificate) and time.monotonic() < until_s and not ends():
        time.sleep(LOOK_S)
        certificate = certificate | _newest(robot, folder, certificate)
    return certificate


def params_with_verdict(
    robot: Robot, answer: dict[str, Any], ends: Callable[[], bool] = lambda: False
) -> dict[str, Any]:
    """The answer of set_params once the new values have a verdict: `tried`, as `last_params` of the status.

    Waits at most MOST_WAIT_S, until `ends()`, or until nothing is on probation. `params` is as it is by then. A verdict
    that is still `taken` comes later, into the certificate of the law.
    """
    if "change" not in answer:  # it came through the mailbox, without a supervisor
        return answer
    until_s, quiet = time.monotonic() + MOST_WAIT_S, 0
    tried: dict[str, Any] = {}
    while True:
        status = robot.call("status")
        newest = status["last_params"] or {}
        if newest.get("change") != answer.get("change"):
            break  # another change was made meanwhile
        tried = newest
        quiet = quiet + 1 if status["probation"]["of"] == "none" else 0
        if tried["verdict"] not in ("sent", "taken") or quiet > 1 or time.monotonic() > until_s or ends():
            break
        time.sleep(LOOK_S)
    now: dict[str, Any] = robot.call("params")
    return answer | now | {"tried": tried}


def _newest(robot: Robot, folder: Path, certificate: dict[str, Any]) -> dict[str, Any]:
    """What is new of it: its file, or what the status tells when there is no file (a full disk)."""
    try:
        read: dict[str, Any] = json.loads((folder / str(certificate.get("certificate"))).read_text(encoding="utf-8"))
        return read
    except (OSError, ValueError):
        last = robot.call("status")["last_swap"] or {}
    if last.get("request_id") != certificate.get("request_id"):
        return {}
    lost = {"rolled_back": {"why": last["reason"]}} if last["verdict"] == "rolled_back" else {}
    return {"verdict": last["verdict"], **lost}


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
