# SPDX-License-Identifier: Apache-2.0
"""The loop of a soak: one action after the other, progress, a state to resume from, and the report."""

from __future__ import annotations

import json
import os
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from . import growth
from .actions import Soak, do, drawn
from .judge import INVARIANTS, Broken, Judge, codes_of_the_page
from .rig import Rig
from .watch import Watch

LINE_S = 60.0
BEFORE = 8  # actions that are repeated before the one that broke


@dataclass
class State:
    """What a soak has come to; kept after each action, and read by --resume."""

    robot: str
    seed: int
    wanted_s: float
    first: int = 0  # number of the first action
    last: int = -1  # of the last one; -1: as many as fit
    next: int = 0
    ran_s: float = 0.0
    actions: dict[str, int] = field(default_factory=dict)
    codes: dict[str, int] = field(default_factory=dict)
    checked: dict[str, int] = field(default_factory=dict)
    stops: dict[str, int] = field(default_factory=dict)
    worst: dict[str, float] = field(default_factory=dict)
    not_done: dict[str, str] = field(default_factory=dict)
    series: dict[str, list[Any]] = field(default_factory=dict)
    records: int = 0
    lost: int = 0
    whole_machine: bool = False
    broke_before: list[dict[str, Any]] = field(default_factory=list)  # what broke: action, invariant, why

    @staticmethod
    def read(path: Path) -> State:
        """The state that another soak left."""
        return State(**json.loads(path.read_text(encoding="utf-8")))

    def write(self, path: Path) -> None:
        """At once or not at all."""
        part = path.with_suffix(".part")
        part.write_text(json.dumps(vars(self)), encoding="utf-8")
        os.replace(part, path)


class Run:
    """A soak from its state on, until its time is over, something breaks, or Ctrl-C."""

    def __init__(self, state: State, out: Path) -> None:
        self.state, self.out = state, out
        out.mkdir(parents=True, exist_ok=True)
        self.judge = Judge(codes_of_the_page())
        self.judge.checked, self.judge.worst = Counter(state.checked), state.worst
        self.judge.stops = Counter(state.stops)
        self.rig = Rig(Path(state.robot).resolve(), out, self.judge)
        self.watch = Watch(self.rig, self.judge)
        self.watch.since_s = state.ran_s
        for name, samples in state.series.items():
            self.watch.series[name] = [(int(pid), t_s, value) for pid, t_s, value in samples]
        self.soak = Soak(self.rig, self.watch, self.judge, state.whole_machine)
        self.soak.codes = Counter(state.codes)
        self.soak.not_done = state.not_done
        self.before = (state.records, state.lost)
        self._line_s = 0.0

    def start(self) -> None:
        """The robot, active. Broken: it cannot even be started."""
        self.rig.start()
        self.watch.attach()
        self.soak.way_back()

    def go_on(self) -> None:
        """Actions until the time is over; the state is kept after each. Raises Broken."""
        state, before_s = self.state, self.state.ran_s
        began_s = time.monotonic()
        while state.ran_s < state.wanted_s and (state.last < 0 or state.next <= state.last):
            name, random = drawn(state.seed, state.next)
            self.show(name)
            done = do(self.soak, name, random)
            state.actions[name] = state.actions.get(name, 0) + done
            state.next += 1
            state.ran_s = before_s + time.monotonic() - began_s
            self.keep()
        self.soak.way_back()
        self.watch.check()
        self.watch.chain()

    def keep(self) -> None:
        """The state, in its file."""
        state, judge = self.state, self.judge
        state.codes, state.checked, state.stops = dict(self.soak.codes), dict(judge.checked), dict(judge.stops)
        state.worst, state.not_done, state.series = dict(judge.worst), self.soak.not_done, dict(self.watch.series)
        state.records, state.lost = self.before[0] + self.watch.records, self.before[1] + self.watch.lost
        state.write(self.out.parent / "soak.state.json")

    def show(self, action: str) -> None:
        """A line a minute; on a terminal one line that changes."""
        now, state = time.monotonic(), self.state
        if not sys.stdout.isatty() and now < self._line_s:
            return
        self._line_s = now + LINE_S
        swaps = self.soak.codes["swap ok"]
        share = 100 * state.ran_s / max(state.wanted_s, 1e-9)
        memory = {name: f"{points[-1][2] / 1024:.1f}" for name in ("spine", "supervisor", "lawd")
                  if (points := self.watch.series.get(f"{name}_rss_kb"))}  # fmt: skip
        told = (
            f"soak {share:3.0f} % of {state.wanted_s:.0f} s, action {state.next} ({action}), {swaps} swaps, MB {memory}"
        )
        print(
            f"\r{told:<110.110}" if sys.stdout.isatty() else told, end="" if sys.stdout.isatty() else "\n", flush=True
        )

    def close(self) -> None:
        """Ends everything that was started."""
        self.watch.close()
        self.soak.load.close()
        self.rig.close()


def repeat(state: State) -> str:
    """How to see it again: the last actions, which need not be enough, or all of them."""
    words = f"python -m tools.soak --robot {state.robot} --seed {state.seed} --seconds 36000"
    words += " --whole-machine" if state.whole_machine else ""
    return (
        f"{words} --first {max(state.first, state.next - BEFORE)} --last {state.next} (or all: --first {state.first})"
    )


def report(state: State, broken: Broken | None, interrupted: bool) -> dict[str, Any]:
    """What out/soak.json has."""
    series = {name: [(int(pid), t_s, value) for pid, t_s, value in points] for name, points in state.series.items()}
    try:
        grown = growth.judged(series)
    except Broken as found:
        grown, broken = {"broken": found.why}, broken or found
    told = {key: value for key, value in vars(state).items() if key not in ("series", "checked")}
    invariants = {name: {"says": says, "checked": state.checked.get(name, 0)} for name, says in INVARIANTS.items()}
    if not broken and (why := growth.not_judged(grown)):
        invariants["growth"] |= {"checked": 0, "why": why}
    whole = all(each["checked"] for each in invariants.values())
    verdict = "broken" if broken else "interrupted" if interrupted else "held" if whole else "incomplete"
    told |= {"verdict": verdict, "invariants": invariants, "growth": grown}
    if broken:
        told["broken"] = {"invariant": broken.invariant, "why": broken.why, "action": state.next,
                          "action_name": drawn(state.seed, state.next)[0], "repeat": repeat(state)}  # fmt: skip
    return told


def one_line(told: dict[str, Any]) -> str:
    """The verdict."""
    done = f"{sum(told['actions'].values())} actions in {told['ran_s']:.0f} s, seed {told['seed']}"
    before = "".join(
        f"; broke before at action {each['action']}: {each['invariant']}: {each['why']}; resumed"
        for each in told["broke_before"]
    )
    if told["verdict"] == "broken":
        broken = told["broken"]
        return (f"BROKEN at action {broken['action']} ({broken['action_name']}), seed {told['seed']}: "
                f"{broken['invariant']}: {broken['why']}{before}\n  repeat: {broken['repeat']}")  # fmt: skip
    left = "".join(f"; not done: {name} ({why})" for name, why in told["not_done"].items())
    unseen = [
        f"{name} ({each['why']})" if "why" in each else name
        for name, each in told["invariants"].items()
        if not each["checked"]
    ]
    left += f"; not checked: {', '.join(unseen)}" if unseen else ""
    words = {"held": "held", "incomplete": "INCOMPLETE, held so far (a longer one, or --resume)"}
    word = words.get(told["verdict"], "held so far (interrupted; --resume goes on)")
    checks = sum(each["checked"] for each in told["invariants"].values())
    return f"{word}: {done}, {checks} checks of {len(told['invariants'])} invariants{left}{before}"
