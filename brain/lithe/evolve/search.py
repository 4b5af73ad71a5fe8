# SPDX-License-Identifier: Apache-2.0
"""The search: CMA-ES (Hansen, arXiv 1604.00772; the package `cma`) over the parameters of each law, turn by turn.

Candidates are drawn in batches and told in order, so the result depends on the seed only, not on how many processes
evaluate them. Each score is kept in a journal; a search that was interrupted draws the same candidates again and takes
their scores from there.
"""

from __future__ import annotations

import hashlib
import json
import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..errors import LitheError
from .evaluate import Candidate, Score, Unit

BATCH = 8
REFUSED = 1e3  # what the optimiser is told of a refused candidate
NO_DEFAULT = 0.01  # of its range: the first step of a parameter whose default is 0

Map = Callable[[Sequence[Candidate]], list[Score]]


@dataclass(frozen=True)
class Plan:
    """What is searched. `budget`: candidates in all."""

    robot: str
    cache: str
    seed: int = 1
    budget: int = 64
    torque_weight: float = 0.0

    def fingerprint(self, units: Sequence[Unit]) -> dict[str, Any]:
        """What must be the same when a search is resumed."""
        texts = [Path(self.robot).read_text(encoding="utf-8"), *(unit.source for unit in units)]
        return {
            "seed": self.seed, "budget": self.budget, "torque_weight": self.torque_weight,
            "laws": [unit.name for unit in units], "sha256": hashlib.sha256("\0".join(texts).encode()).hexdigest(),
        }  # fmt: skip


@dataclass(frozen=True)
class Found:
    """The best candidate of a law, or of all."""

    law: str
    params: dict[str, float]
    score: Score


class _Species:
    """One law, and the optimiser of its parameters: steps around the defaults, in units of their size."""

    def __init__(self, unit: Unit, seed: int) -> None:
        self.unit = unit
        self._scale = [abs(value) / 2 or NO_DEFAULT * (most - least) for _, value, least, most in unit.params]
        self._first = True
        self._optimiser: Any = None
        if unit.params:
            try:
                import cma
            except ImportError:
                raise LitheError("the optimiser is missing\n  next: pip install cma") from None
            dimensions = max(2, len(unit.params))  # it works in two dimensions at least
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self._optimiser = cma.CMAEvolutionStrategy(
                    [0.0] * dimensions, 0.7, {"seed": seed, "popsize": BATCH, "verbose": -9}
                )

    def draw(self) -> tuple[list[list[float]], list[dict[str, float]]]:
        """A batch: points of the optimiser, and their parameters. The first one of all has the defaults."""
        points = [[float(x) for x in point] for point in self._optimiser.ask()] if self._optimiser else [[]]
        if self._first and self._optimiser:
            points[0] = [0.0] * len(points[0])
        self._first = False
        return points, [self._params(point) for point in points]

    def _params(self, point: Sequence[float]) -> dict[str, float]:
        return {
            name: min(max(value + scale * x, least), most)
            for (name, value, least, most), scale, x in zip(self.unit.params, self._scale, point, strict=False)
        }

    def tell(self, points: list[list[float]], scores: Sequence[Score]) -> None:
        if self._optimiser:
            values = [score.value if math.isfinite(score.value) else REFUSED for score in scores]
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self._optimiser.tell(points, values)

    @property
    def exhausted(self) -> bool:
        """A law without parameters is one candidate."""
        return not self._optimiser and not self._first


class Journal:
    """All scores so far, one JSON line each, after a line that says what is searched."""

    def __init__(self, path: Path, fingerprint: dict[str, Any], resume: bool) -> None:
        """Begins anew, or reads what is there. LitheError when that is another search."""
        self._path = path
        self._known: list[dict[str, Any]] = []
        if resume:
            try:
                text = path.read_text(encoding="utf-8")
            except OSError as error:
                raise LitheError(f"nothing to resume: {error}\n  next: start without --resume") from None
            whole = text[: text.rfind("\n") + 1]  # the last line may have been cut off
            lines = [json.loads(line) for line in whole.splitlines()]
            if not lines or lines[0] != fingerprint:
                before = lines[0] if lines else {}
                other = [key for key in fingerprint if before.get(key) != fingerprint[key]]
                raise LitheError(
                    f"{path} is of another search: {', '.join(other)} differ\n"
                    "  next: the same words as then, or no --resume"
                )
            self._known = lines[1:]
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("w", encoding="utf-8")
        for each in (fingerprint, *self._known):
            self._write(each)
        self._at = 0

    def _write(self, what: dict[str, Any]) -> None:
        self._file.write(json.dumps(what) + "\n")
        self._file.flush()

    def known(self, law: str, params: dict[str, float]) -> Score | None:
        """The next score, if it is there. LitheError when it is of another candidate."""
        if self._at >= len(self._known):
            return None
        one = self._known[self._at]
        if one["law"] != law or one["params"] != params:
            raise LitheError(
                f"candidate {self._at} of {self._path} is not the one that is drawn now\n"
                "  next: start without --resume; or with the versions of cma and numpy of then"
            )
        self._at += 1
        score: dict[str, Any] = {key: math.inf if value is None else value for key, value in one["score"].items()}
        return Score(**score)

    def add(self, law: str, params: dict[str, float], score: Score) -> None:
        """One more."""
        plain = {key: None if value == math.inf else value for key, value in asdict(score).items()}
        self._write({"law": law, "params": params, "score": plain})

    def close(self) -> None:
        """Nothing more comes."""
        self._file.close()


class Search:
    """Runs the plan; `best` by law, `refused` counts, by reason. `say` is told after each batch how many are done."""

    def __init__(self, plan: Plan, units: Sequence[Unit], journal: Journal, say: Callable[[int, str], None]) -> None:
        self._plan, self._journal, self._say = plan, journal, say
        self._species = [_Species(unit, plan.seed + 1000 * i) for i, unit in enumerate(units)]
        self.best: dict[str, Found] = {}
        self.refused: dict[str, int] = {}
        self.done = 0

    def run(self, scores_of: Map) -> Found | None:
        """The best of all, None when every candidate was refused. scores_of: scores in the order of its candidates."""
        while self.done < self._plan.budget and any(not one.exhausted for one in self._species):
            for one in self._species:
                if not one.exhausted and self.done < self._plan.budget:
                    self._turn(one, scores_of)
        return min(self.best.values(), key=lambda found: found.score.value, default=None)

    def _turn(self, one: _Species, scores_of: Map) -> None:
        points, batch = one.draw()
        batch = batch[: self._plan.budget - self.done]
        scores = []
        for params in batch:
            if (score := self._journal.known(one.unit.name, params)) is None:
                break
            scores.append(score)
        plan = self._plan
        fresh = [
            Candidate(plan.robot, one.unit.object, plan.cache, params, plan.torque_weight)
            for params in batch[len(scores) :]
        ]
        for candidate, score in zip(fresh, scores_of(fresh) if fresh else [], strict=True):
            self._journal.add(one.unit.name, candidate.params, score)
            scores.append(score)
        if len(scores) == len(points):  # a batch that the budget cut off is the last
            one.tell(points, scores)
        self.done += len(scores)
        for params, score in zip(batch, scores, strict=True):
            if score.refused:
                self.refused[score.refused] = self.refused.get(score.refused, 0) + 1
                continue
            now = self.best.get(one.unit.name)
            if now is None or score.value < now.score.value:
                self.best[one.unit.name] = Found(one.unit.name, params, score)
        found = self.best.get(one.unit.name)
        said = f"best {found.score.value:.5f} rad" if found else "none accepted yet"
        self._say(self.done, f"{one.unit.name}: {said}, {sum(self.refused.values())} refused")
