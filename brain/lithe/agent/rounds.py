# SPDX-License-Identifier: Apache-2.0
"""The loop: measure, identify, propose, swap, compare, keep the best.

Before each swap the best law runs. So a law that is not better is taken back by `activate`, and however the loop ends,
the best law runs. If verbs can end the stop, the generation has failed and the run continues. No setting and nothing
that a model answers can change the terms of a swap.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from ..errors import LitheError
from ..identify import Motion
from . import prompt
from .extract import NoLaw, law_in
from .link import AnotherLaw, Link, Lost, Stopped
from .model import Model, ModelError
from .plant import identified
from .prompt import Try
from .reference import Streamer, grown
from .score import Measured, better, score

MOST_WINDOWS = 10  # that a broken connection may spoil, one after the other
MOST_MOTIONS = 6  # measurements that are identified together
SETTLE_S = 0.4  # after a commit; the blend is over by then
SAYS_NOTHING = ("compile_starved", "trial_starved")  # of the law: it may be answered again
MOST_STOPS = 5  # one after the other, on the way back from the first


@dataclass(frozen=True)
class Limits:
    """`rounds` with the model, `swaps` at the robot, `failures` in a row that end it; `window_s`: least measurement."""

    rounds: int = 10
    swaps: int = 25
    failures: int = 5
    window_s: float = 4.0
    share: float = 0.5
    growth: float = 1.5
    score: str = "rms"  # of SCORES; the amplitude does not grow where it is no error


@dataclass(frozen=True)
class Best:
    """A law that was kept: its generation, its id in the robot, its text ("": not known)."""

    number: int
    law_id: int
    source: str


@dataclass
class Result:
    """Of a whole run; `why`: what ended it. Generation 0 is the law that ran at the start."""

    tries: list[Try] = field(default_factory=list)
    best: int = 0
    source: str = ""
    model: str = ""  # the equations of which `plant` has the values
    plant: list[dict[str, Any]] = field(default_factory=list)
    why: str = ""
    swaps: int = 0
    stops: int = 0
    stopped: bool = False
    kind: str = "rms"

    @property
    def ratio(self) -> float:
        """Score of the start over that of the best law; each as measured, the later perhaps with a larger amplitude."""
        start, best = (score(self.tries[i].measured, self.kind) for i in (0, self.best))
        return start / max(best, 1e-9)


class Rounds:
    """Runs the loop once. `keep(name, text)` writes a law beside the transcript, `say` tells what happens."""

    def __init__(
        self,
        link: Link,
        moves: Streamer,
        model: Model,
        goal: str,
        limits: Limits,
        say: Callable[..., None] = lambda kind, **what: None,
        keep: Callable[[str, str], str] = lambda name, text: "",
        source: str = "",
    ) -> None:
        self.link, self.moves, self.model, self.goal, self.limits = link, moves, model, goal, limits
        self._say, self._keep = say, keep
        self._grows = moves.reference.grows and limits.score != "torque"
        self.share = min(1.0, limits.share) if moves.reference.grows else 1.0
        self._window_s = moves.reference.window_s(limits.window_s)
        self.result = Result(source=source, kind=limits.score)
        self._bests: list[Best] = []
        self._running = 0  # what was last known to run
        self._motions: list[list[Motion]] = []
        self._seen: set[str] = set()

    def run(self) -> Result:
        """Never raises LitheError: what ended it is in the result. The best law runs then, also after any other error,
        but not on a robot that has stopped, and not in place of another client's law.
        """
        result = self.result
        try:
            self._start()
            self._rounds()
        except (Lost, Stopped, AnotherLaw) as end:
            result.why, result.stopped = str(end), True
        except LitheError as error:
            result.why = str(error)
        except KeyboardInterrupt:
            result.why = "interrupted"
        finally:
            self._end()
        return result

    # ---- measuring
    def _start(self) -> None:
        self.moves.start(self.share)
        told = self._measured()
        self._identify()
        self.result.source = self.result.source or self.link.source_of(told.law_id)
        self._seen.add(self.result.source)
        self._bests = [Best(0, told.law_id, self.result.source)]
        self._note(Try(0, "start", "confirmed", share=self.share, measured=told, kept=True))

    def _identify(self) -> None:
        """From the last measurements, whatever law ran in them."""
        with self.link.alive():
            self.result.model, self.result.plant = identified(self.link.names, self._motions, self.link.chain)
        self._say("identified", plant=self.result.plant)

    def _measured(self) -> Measured:
        """On the reference all the while: at rest, where a broken connection leaves the robot, every law is good."""
        for _ in range(MOST_WINDOWS):
            since_ns = self.moves.go_on()
            told, motions = self.link.measure(self._window_s)
            if self.moves.went_on(since_ns):
                break
            self._say("not_measured", message="the reference ended meanwhile")
        else:
            raise LitheError(f"the reference ended in each of {MOST_WINDOWS} measurements: is the connection that bad?")
        self._motions = [*self._motions, motions][-MOST_MOTIONS:]
        return Measured.of(told, self.link.names)

    # ---- rounds
    def _rounds(self) -> None:
        failures = 0
        for number in range(1, self.limits.rounds + 1):
            self.result.swaps = self.link.swaps
            if self.result.swaps >= self.limits.swaps:
                self.result.why = f"the budget of {self.limits.swaps} swaps is used up"
                return
            if failures >= self.limits.failures:
                self.result.why = f"{failures} generations in a row were no better"
                return
            kept = self._round(number)
            failures = 0 if kept else failures + 1
        self.result.why = f"all {self.limits.rounds} rounds are over"

    def _round(self, number: int) -> bool:
        """One generation, also one that stops the robot. Whether its law is the best now."""
        name = f"agent_{number:03}.cpp"
        try:
            self._still_best()
            one = self._generation(number, name)
        except Stopped as stop:
            one = Try(number, name, "stopped", str(stop), self.share)
            self._come_back(stop, stop.by_law and self._running == self._bests[-1].law_id)
        self._note(one)
        if one.kept:
            try:
                self._grow()
            except Stopped as stop:  # this motion is too much
                self._grows, self.share = False, one.share
                self._come_back(stop, stop.by_law)
        return bool(self.result.tries[number].kept)

    def _still_best(self) -> None:
        """The best law runs. One that failed meanwhile, so that the Spine took it back, is the best no longer."""
        self._running = self._ours(self.link.law_id())
        while self._bests[-1].law_id != self._running:
            if self._running not in [each.law_id for each in self._bests[:-1]]:
                raise LitheError(f"law {self._running} runs, which is not the best")
            self._demote("taken_back", self.link.taken_back())

    def _ours(self, law_id: int) -> int:
        """That id. AnotherLaw: it is of no law of this run, so that this run must not replace it."""
        if law_id not in [each.law_id for each in self._bests] and not self.link.put_in(law_id):
            raise AnotherLaw(f"law {law_id} runs, which is none of this run: another client or the Spine put it in")
        return law_id

    def _demote(self, verdict: str, said: str) -> None:
        """The law before the best one is the best again."""
        gone = self._bests.pop()
        shown = replace(self.result.tries[gone.number], verdict=verdict, said=said, kept=False)
        self.result.tries[gone.number] = shown
        self.result.best, self.result.source = self._bests[-1].number, self._bests[-1].source
        self._say("demoted", **asdict(shown))

    def _generation(self, number: int, name: str) -> Try:
        try:
            with self.link.alive():
                answer = self.model.ask(self._messages())
            source, told = law_in(answer)
        except (ModelError, NoLaw) as error:
            return Try(number, name, error.kind, error.message, self.share)
        if source in self._seen:
            return Try(number, name, "repeated", "the same law was answered before; write another one", self.share)
        self._still_best()  # a model thinks for long
        self._seen.add(source)
        self._say("proposed", name=name, sha256=self._keep(f"laws/{name}", source), mended=told)
        before, self._running = self._bests[-1].law_id, 0  # not known while the swap is under way
        done = self.link.swap(source, name)
        if not done.runs:
            if done.verdict in SAYS_NOTHING:
                self._seen.discard(source)
            found = done.detail.get("diagnostics")
            seen = found if isinstance(found, list) else []
            return Try(number, name, done.verdict, done.said, self.share, diagnostics=seen)
        self._running = done.law_id
        one = self._compared(number, name, done.law_id, before)
        if one.kept:
            self._take_as_best(Best(number, done.law_id, source))
        else:
            self._back_to_best()
        return one

    def _messages(self) -> list[dict[str, Any]]:
        result = self.result
        how = prompt.How(self.goal, self.moves.reference.words, result.kind)
        plant = result.model, result.plant
        best = result.source, result.tries[result.best].measured
        return prompt.messages(how, self.link.joints, self.link.rate_hz, plant, best, result.tries[1:])

    def _compared(self, number: int, name: str, law_id: int, before: int) -> Try:
        """Measures the law that was committed, and waits for its verdict."""
        self.link.sleep(SETTLE_S)
        told: Measured | None = None
        try:
            told = self._measured()
            self._identify()
        except (Stopped, Lost):
            raise
        except LitheError as error:  # it was taken back meanwhile
            self._say("not_measured", name=name, message=str(error))
        done = self.link.outcome(name, before)
        if done.law_id != law_id:
            self._ours(done.law_id)
        told = told if told is not None and told.law_id == law_id else None
        if not done.runs or told is None or done.law_id != law_id:
            verdict = "taken_back" if done.verdict == "confirmed" else done.verdict or "rolled_back"
            said = self.link.taken_back() if verdict in ("taken_back", "rolled_back") else done.said
            return Try(number, name, verdict, said, self.share, told)
        tries = self.result.tries
        kept = done.verdict == "confirmed" and better(
            told, tries[self.result.best].measured, tries[0].measured, self.result.kind
        )
        return Try(number, name, done.verdict, done.said, self.share, told, kept)

    def _take_as_best(self, best: Best) -> None:
        self._bests.append(best)
        self.result.best, self.result.source = best.number, best.source

    def _back_to_best(self) -> None:
        best = self._bests[-1]
        self._ours(self.link.law_id())
        self._running = self.link.go_back_to(best.law_id, best.source, f"best_{best.number:03}.cpp")
        self._bests[-1] = replace(best, law_id=self._running)

    def _come_back(self, stop: Stopped, blamed: bool) -> None:
        """The best law runs again and is measured again. `blamed`: it has stopped the robot itself, so it is the law
        before it that does. Lost: no verb leads back, or there is none before it.
        """
        for _ in range(MOST_STOPS):
            self.result.stops += 1
            self._say("stopped", message=str(stop), stop=stop.stop)
            if not stop.mendable:
                raise Lost(f"{stop}; this is for a person to look at")
            if blamed and len(self._bests) == 1:
                raise Lost(f"{stop}; the law at the start stops the robot, too")
            if blamed:
                self._demote("stopped", str(stop))
            best = self._bests[-1]
            try:
                self._running = self.link.come_back(best.law_id, best.source, f"best_{best.number:03}.cpp")
                self._bests[-1] = replace(best, law_id=self._running)
                self._still_best()
                self.moves.start(self.share)
                self._measure_best()
                return
            except Stopped as again:
                stop, blamed = again, again.by_law
        raise Lost(f"the robot stopped {MOST_STOPS} times in a row: {stop}")

    def _measure_best(self) -> None:
        told = self._measured()
        if self._ours(told.law_id) != self._bests[-1].law_id:
            raise LitheError("the best law was replaced meanwhile")
        best = self.result.tries[self.result.best]
        self.result.tries[self.result.best] = replace(best, share=self.share, measured=told)

    def _grow(self) -> None:
        """A larger amplitude after a better law, which is measured again: the next is compared on the same motion."""
        share = grown(self.share, self.limits.growth) if self._grows else self.share
        if share <= self.share:
            return
        self.moves.start(share)
        self.share = share
        self._measure_best()
        self._say("grown", **asdict(self.result.tries[self.result.best]))

    def _note(self, one: Try) -> None:
        self.result.tries.append(one)
        self._say("generation", **asdict(one))

    def _end(self) -> None:
        """The best law runs, and the setpoint rests, whatever happened; not where another moves the robot now."""
        result = self.result
        self._say, self.link.say = _unheard(self._say), _unheard(self.link.say)
        try:
            if self._bests and not self.link.gone and not result.stopped:
                self._end_on_best()
        except (LitheError, KeyboardInterrupt) as error:
            self._say("trouble", message=str(error))
            if not result.stopped:
                result.why, result.stopped = f"{result.why}; {error}", True
        try:
            if not self.link.gone:
                self.moves.stop()
        except (LitheError, KeyboardInterrupt) as error:
            self._say("trouble", message=str(error))
        result.swaps = self.link.swaps
        self._say("end", why=result.why, best=result.best, swaps=result.swaps, stops=result.stops)

    def _end_on_best(self) -> None:
        """Not on a robot that has stopped: nothing of this run is left that would have to move it."""
        try:
            self._still_best()
        except (Lost, Stopped, AnotherLaw):
            raise
        except LitheError:
            self._back_to_best()


def _unheard(say: Callable[..., None]) -> Callable[..., None]:
    """The same, but that nobody can be told, as with a full disk, ends nothing."""

    def tell(kind: str, /, **what: Any) -> None:
        with contextlib.suppress(OSError):
            say(kind, **what)

    return tell
