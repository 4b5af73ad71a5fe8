# SPDX-License-Identifier: Apache-2.0
"""Soak: random swaps, kills, faults and loads on one simulated robot, with invariants checked all the time.

`python -m tools.soak [--hours H | --seconds S] [--seed N] [--robot FILE] [--resume]` -> out/soak.json and one line.
Everything is drawn from the seed; the state after each action is in out/soak.state.json. Exit 0: held, 1: broken (the
line names invariant, action, seed, and how to repeat it) or incomplete (an invariant was never checked; in a short
soak it is growth), 2: it cannot run. Ctrl-C ends it with the verdict so far.
"""

from __future__ import annotations

import argparse
import fcntl
import json
import shutil
import sys
import time
from pathlib import Path

import lithe  # noqa: F401  (before numpy, whose threads it limits)
from lithe.errors import LitheError
from lithe.programs import ROOT

from .judge import Broken
from .run import Run, State, one_line, report


def arguments(words: list[str]) -> argparse.Namespace:
    """What is asked for."""
    parser = argparse.ArgumentParser(prog="python -m tools.soak", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, help="how long (default 7200)")
    parser.add_argument("--hours", type=float, help="the same in hours")
    parser.add_argument("--seed", type=int, help="of all actions (default: one of its own, which is told)")
    parser.add_argument("--robot", type=Path, default=ROOT / "robots/arm.toml", help="a simulated robot")
    parser.add_argument("--out", type=Path, default=ROOT / "out", help="for soak.json (default out)")
    parser.add_argument("--first", type=int, default=0, help="number of the first action (default 0)")
    parser.add_argument("--last", type=int, default=-1, help="number of the last one (default: until the time is over)")
    parser.add_argument("--resume", action="store_true", help="go on where the last soak ended")
    parser.add_argument("--whole-machine", action="store_true",
                        help="also step the time of day and unplug cores: every program here sees it")  # fmt: skip
    asked = parser.parse_args(words)
    if asked.seconds is not None and asked.hours is not None:
        parser.error("--seconds or --hours, not both")
    if asked.hours is not None:
        asked.seconds = 3600 * asked.hours
    if asked.seconds is not None and not 0 < asked.seconds < 1e7:
        parser.error("the time must be above 0")
    return asked


def state_of(asked: argparse.Namespace) -> State:
    """A new soak, or the one that is resumed."""
    path: Path = asked.out / "soak.state.json"
    if asked.resume:
        try:
            state = State.read(path)
        except (OSError, ValueError, TypeError) as why:
            raise LitheError(f"nothing to resume in {path}: {why}\n  next: start without --resume") from None
        state.wanted_s = asked.seconds or state.wanted_s
        state.whole_machine |= asked.whole_machine
        return state
    shutil.rmtree(asked.out / "soak", ignore_errors=True)
    seed = asked.seed if asked.seed is not None else time.time_ns() % 1_000_000
    first, wanted_s, whole = asked.first, asked.seconds or 7200.0, asked.whole_machine
    return State(str(asked.robot), seed, wanted_s, first, asked.last, next=first, whole_machine=whole)


def soak(asked: argparse.Namespace) -> int:
    """One soak to its end; the exit code."""
    state = state_of(asked)
    print(f"soak: {state.robot}, seed {state.seed}, from action {state.next}", flush=True)
    broken: Broken | None = None
    interrupted = False
    run = Run(state, asked.out / "soak")
    try:
        try:
            run.start()
        except Broken as why:
            raise LitheError(f"the robot did not start: {why}\n  next: see {asked.out / 'soak/run.log'}") from None
        try:
            run.go_on()
        except Broken as found:
            broken = found
    except KeyboardInterrupt:
        interrupted = True
    finally:
        run.close()
    broken = run.watch.broken or broken  # it may have seen the cause before the action ended, or before Ctrl-C
    told = report(state, broken, interrupted)
    (asked.out / "soak.json").write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
    if "broken" in told:  # a resumed soak must tell it
        broke = {name: told["broken"][name] for name in ("action", "invariant", "why")}
        state.broke_before = [*state.broke_before, broke]
        state.write(asked.out / "soak.state.json")
    print(("\n" if sys.stdout.isatty() else "") + one_line(told))
    return 1 if told["verdict"] in ("broken", "incomplete") else 0


def main(words: list[str]) -> int:
    """2: it cannot run, and why."""
    asked = arguments(words)
    asked.out.mkdir(parents=True, exist_ok=True)
    with (asked.out / "soak.lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return soak(asked)
        except BlockingIOError:
            print(f"soak: another one runs in {asked.out}: wait for it, or use --out", file=sys.stderr)
        except (LitheError, OSError) as why:
            print(f"soak: cannot run: {why}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
