# SPDX-License-Identifier: Apache-2.0
"""What a candidate is worth: the compile service makes an object of its source, a trial runs it on the simulated robot.

These are the programs that a swap goes through, so what they refuse here would be refused by the robot. A trial counts
its own ticks, not the clock, so the same candidate gets the same score on every machine.
"""

from __future__ import annotations

import atexit
import json
import math
import os
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import LitheError
from ..programs import binary

BUDGET_NS = 5_000_000  # of a step: how fast the law is, is for the robot's own trial to judge
BOX_MS = 2_000  # processor time of a trial; it takes about 15
ATTEMPTS = 20  # while a busy machine gives the trial no processor time


@dataclass(frozen=True)
class Unit:
    """A law that compiles: its text, its object, and of each parameter name, default, least and most."""

    name: str
    source: str
    object: str
    params: tuple[tuple[str, float, float, float], ...]


@dataclass(frozen=True)
class Candidate:
    """One law with values of its parameters, to be tried on a robot file. Everything a process needs to do so."""

    robot: str
    object: str
    cache: str
    params: dict[str, float]
    torque_weight: float  # [rad/(N m)]


@dataclass(frozen=True)
class Score:
    """`value` is minimised: root mean square of the tracking errors [rad] of the ideal and of the rough robot, plus
    torque_weight times the largest torque. `refused`: why the trial refused it (value inf), else empty.
    """

    value: float
    error_rad: float
    rough_error_rad: float
    torque_nm: float
    refused: str = ""


class _Program:
    """A program that answers each JSON line with one."""

    def __init__(self, cache: str, *words: str | Path) -> None:
        self._name = Path(words[0]).name
        self._process = subprocess.Popen(
            words, env=os.environ | {"LITHE_CACHE_DIR": cache}, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def ask(self, **request: Any) -> dict[str, Any]:
        assert self._process.stdin is not None and self._process.stdout is not None
        for _ in range(ATTEMPTS):
            try:
                self._process.stdin.write(json.dumps(request) + "\n")
                self._process.stdin.flush()
                answer: dict[str, Any] = json.loads(self._process.stdout.readline())
            except (OSError, ValueError) as error:
                raise LitheError(
                    f"{self._name} has ended: {error}\n  next: start the search again with --resume"
                ) from None
            if not answer.get("starved"):
                return answer
        raise LitheError(
            f"this machine gave {self._name} no processor time, {ATTEMPTS} times in a row\n"
            "  next: end other programs, then --resume"
        )

    def close(self) -> None:
        self._process.communicate()


_trials: dict[tuple[str, str], _Program] = {}  # of this process, by robot file and cache


def compile_laws(sources: Sequence[tuple[str, str]], joints: int, cache: str) -> list[Unit]:
    """Laws (name, text) as objects. LitheError with the compiler's words when one is refused."""
    service = _Program(cache, binary("lawd"))
    found = []
    try:
        for name, text in sources:
            answer = service.ask(verb="compile", source=text, name=name, joints=joints)
            if not answer["ok"]:
                said = "\n".join([str(answer.get("text") or answer.get("reason", "")), *answer.get("hints", [])])
                raise LitheError(f"{name} was refused ({answer.get('stage')}):\n{said}")
            params = tuple(
                (str(one["name"]), float(one["value"]), float(one["min"]), float(one["max"]))
                for one in answer["law"]["params"]
            )
            found.append(Unit(name, text, str(answer["object"]), params))
    finally:
        service.close()
    return found


def evaluate(candidate: Candidate) -> Score:
    """Tries it. Keeps one trial program per process, so that many candidates cost no more than their runs."""
    key = candidate.robot, candidate.cache
    if key not in _trials:
        _trials[key] = _Program(candidate.cache, binary("lithe-trial"), candidate.robot)
        atexit.register(_trials[key].close)
    answer = _trials[key].ask(
        verb="try", object=candidate.object, params=candidate.params, budget_ns=BUDGET_NS, box_ms=BOX_MS
    )
    if answer.get("unavailable"):
        raise LitheError(f"no trial is possible here: {answer.get('reason') or answer.get('text')}")
    if not answer["ok"]:
        said = str(answer.get("reason") or answer.get("text") or "refused")
        return Score(math.inf, math.inf, math.inf, math.inf, said)
    ideal = answer["report"]["loop"]
    rough = ideal["rough"]
    errors = float(ideal["rms_error_rad"]), float(rough["rms_error_rad"])
    torque = max(float(ideal["most_torque_nm"]), float(rough["most_torque_nm"]))
    value = math.sqrt((errors[0] ** 2 + errors[1] ** 2) / 2) + candidate.torque_weight * torque
    return Score(value, *errors, torque)
