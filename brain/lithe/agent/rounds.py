# SPDX-License-Identifier: Apache-2.0
"""The loop: measure, identify, propose, swap, compare, keep the best.

Before each swap the best law runs. So one rollback takes a law back that is not better, and however the loop ends, the
best law runs. No setting and nothing that a model answers can change the terms of a swap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from ..errors import LitheError
from ..identify import Motion
from . import prompt
from .extract import NoLaw, law_in
from .link import Link, Stopped, identified
from .model import ModelError, Reply
from .prompt import Try
from .reference import grown

MOST_WINDOWS = 10  # that a broken connection may spoil, one after the other
MOST_MOTIONS = 6  # measurements that are identified together
SETTLE_S = 0.4  # after a commit; the blend is over by then
LEAST_GAIN = 0.99  # of the score, that makes a law the new best
MOST_WORSE, FREE_DEG = 2.0, 0.1  # no joint of a new best may become so many times worse, beyond so much


@dataclass(frozen=True)
class Limits:
    """`rounds` with the model, `swaps` at the robot, `failures` in a row that end it; `window_s` of a measurement."""

    rounds: int = 10
    swaps: int = 25
    failures: int = 5
    window_s: float = 4.0
    share: float = 0.5
    growth: float = 1.5


@dataclass
class Result:
    """Of a whole run; `why`: what ended it. Generation 0 is the law that ran at the start."""

    tries: list[Try] = field(default_factory=list)
    best: int = 0
    source: str = ""
    plant: list[dict[str, Any]] = field(default_factory=list)
    why: str = ""
    swaps: int = 0
    stopped: bool = False

    @property
    def ratio(self) -> float:
        """RMSE of the start over that of the best law; each as measured, the later perhaps with a larger amplitude."""
        return score(self.tries[0].rmse_deg) / max(score(self.tries[self.best].rmse_deg), 1e-9)


class Moves(Protocol):
    """The reference; see Streamer."""

    def start(self, frequency_hz: float, share: float) -> None: ...

    def go_on(self) -> int: ...

    def went_on(self, since_ns: int) -> bool: ...

    def stop(self) -> None: ...


class Asked(Protocol):
    """The model; see Model."""

    def ask(self, messages: list[dict[str, Any]]) -> Reply: ...


def score(rmse_deg: list[float]) -> float:
    """Of all joints: the smaller the better [deg]."""
    return float(np.sqrt(np.mean(np.square(rmse_deg))))


def better(new_deg: list[float], best_deg: list[float]) -> bool:
    """All joints together, and no joint at the others' cost."""
    worse = any(new > MOST_WORSE * old + FREE_DEG for new, old in zip(new_deg, best_deg, strict=True))
    return score(new_deg) < LEAST_GAIN * score(best_deg) and not worse


class Rounds:
    """Runs the loop once. `keep(name, text)` writes a law beside the transcript, `say` tells what happens."""

    def __init__(
        self,
        link: Link,
        moves: Moves,
        model: Asked,
        goal: str,
        frequency_hz: float,
        limits: Limits,
        say: Callable[..., None] = lambda kind, **what: None,
        keep: Callable[[str, str], str] = lambda name, text: "",
        source: str = "",
    ) -> None:
        self.link, self.moves, self.model, self.goal, self.limits = link, moves, model, goal, limits
        self.frequency_hz, self._say, self._keep = frequency_hz, say, keep
        self.share = min(1.0, limits.share)
        self.result = Result(source=source)
        self._best_id = 0
        self._motions: list[list[Motion]] = []
        self._seen = {source}

    def run(self) -> Result:
        """Never raises LitheError: what ended it is in the result, and the best law runs, if any can."""
        result = self.result
        try:
            self._start()
            self._rounds()
        except Stopped as stop:
            result.why, result.stopped = str(stop), True
        except LitheError as error:
            result.why = str(error)
        except KeyboardInterrupt:
            result.why = "interrupted"
        self._end()
        return result

    def _start(self) -> None:
        self.moves.start(self.frequency_hz, self.share)
        rmse_deg, self._best_id = self._measured()
        self._identify()
        self._note(Try(0, "start", "confirmed", share=self.share, rmse_deg=rmse_deg, kept=True))

    def _identify(self) -> None:
        """From the last measurements, whatever law ran in them."""
        self.result.plant = identified(self.link.names, [list(each) for each in zip(*self._motions, strict=True)])
        self._say("identified", plant=self.result.plant)

    def _measured(self) -> tuple[list[float], int]:
        """On the reference all the while: at rest, where a broken connection leaves the robot, every law is good."""
        for _ in range(MOST_WINDOWS):
            since_ns = self.moves.go_on()
            rmse_rad, motions, law_id = self.link.measure(self.limits.window_s)
            if self.moves.went_on(since_ns):
                break
            self._say("not_measured", message="the reference ended meanwhile")
        else:
            raise LitheError(f"the reference ended in each of {MOST_WINDOWS} measurements: is the connection that bad?")
        self._motions = [*self._motions, motions][-MOST_MOTIONS:]
        return [float(each) for each in np.degrees(rmse_rad)], law_id

    def _rounds(self) -> None:
        failures = 0
        for number in range(1, self.limits.rounds + 1):
            if self.result.swaps >= self.limits.swaps:
                self.result.why = f"the budget of {self.limits.swaps} swaps is used up"
                return
            if failures >= self.limits.failures:
                self.result.why = f"{failures} generations in a row were no better"
                return
            one = self._generation(number)
            self._note(one)
            failures = 0 if one.kept else failures + 1
            if one.kept:
                self._grow()
        self.result.why = f"all {self.limits.rounds} rounds are over"

    def _generation(self, number: int) -> Try:
        name = f"agent_{number:03}.cpp"
        best = self.result.source, self.result.tries[self.result.best].rmse_deg
        asked = prompt.messages(
            self.goal, self.link.joints, self.link.rate_hz, self.result.plant, best, self.result.tries[1:]
        )
        try:
            with self.link.alive():
                answer = self.model.ask(asked)
            source, told = law_in(answer)
        except (ModelError, NoLaw) as error:
            return Try(number, name, error.kind, error.message, self.share)
        if source in self._seen:
            return Try(number, name, "repeated", "the same law was answered before; write another one", self.share)
        self._seen.add(source)
        self._say("proposed", name=name, sha256=self._keep(f"laws/{name}", source), mended=told)
        self.result.swaps += 1
        before = self._best_id
        done = self.link.swap(source, name)
        if not done.runs:
            found = done.detail.get("diagnostics")
            seen = found if isinstance(found, list) else []
            return Try(number, name, done.verdict, done.said, self.share, diagnostics=seen)
        one = self._compared(number, name, done.law_id, before)
        if one.kept:
            self.result.source, self.result.best, self._best_id = source, number, done.law_id
        else:
            self._best_id = self.link.go_back_to(before, self.result.source, f"best_{number:03}.cpp")
        return one

    def _compared(self, number: int, name: str, law_id: int, before: int) -> Try:
        """Measures the law that was committed, and waits for its verdict."""
        self.link.sleep(SETTLE_S)
        rmse_deg: list[float] = []
        try:
            rmse_deg, measured_id = self._measured()
            self._identify()
            rmse_deg = rmse_deg if measured_id == law_id else []
        except Stopped:
            raise
        except LitheError as error:  # it was taken back meanwhile
            self._say("not_measured", name=name, message=str(error))
        done = self.link.outcome(name, before)
        if not done.runs or not rmse_deg or done.law_id != law_id:
            return Try(number, name, done.verdict or "rolled_back", done.said, self.share, rmse_deg)
        best_deg = self.result.tries[self.result.best].rmse_deg
        kept = done.verdict == "confirmed" and better(rmse_deg, best_deg)
        return Try(number, name, done.verdict, done.said, self.share, rmse_deg, kept)

    def _grow(self) -> None:
        """A larger amplitude after a better law, which is measured again: the next is compared on the same motion."""
        share = grown(self.share, self.limits.growth)
        if share <= self.share:
            return
        self.moves.start(self.frequency_hz, share)
        self.share = share
        rmse_deg, law_id = self._measured()
        if law_id != self._best_id:
            raise LitheError("the best law was replaced by another client while its amplitude grew")
        best = self.result.tries[self.result.best]
        grown_try = Try(best.number, best.name, best.verdict, best.said, share, rmse_deg, True)
        self.result.tries[self.result.best] = grown_try
        self._say("grown", share=share, rmse_deg=rmse_deg)

    def _note(self, one: Try) -> None:
        self.result.tries.append(one)
        self._say("generation", **vars(one))

    def _end(self) -> None:
        """The best law runs, and the setpoint rests, whatever happened; not where another moves the robot now."""
        result = self.result
        try:
            if result.tries and not self.link.gone:
                self.link.go_back_to(self._best_id, result.source, "best.cpp")
        except (LitheError, KeyboardInterrupt) as error:
            self._say("trouble", message=str(error))
            if not result.stopped:
                result.why, result.stopped = f"{result.why}; {error}", True
        try:
            if not self.link.gone:
                self.moves.stop()
        except (LitheError, KeyboardInterrupt) as error:
            self._say("trouble", message=str(error))
        self._say("end", why=result.why, best=result.best, swaps=result.swaps)
