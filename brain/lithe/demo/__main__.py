# SPDX-License-Identifier: Apache-2.0
"""Runs the supervised-evolution experiment and judges it: `make demo`.

Four phases on a simulated robot that answers real frames of its drives: baseline, probing, evolution, fault tolerance.
Exit code 0 when the claim holds, 1 when it does not or something broke.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

from lithe.errors import LitheError

from ..programs import ROOT
from . import figures, judge, recorder
from .experiment import Experiment
from .joints import SimJoint, simulated_joints
from .processes import Disturbed, Stage
from .report import report

TRIES = 3
PAUSE_S = 3.0  # before another try: what kept the machine busy may be over by then
NEEDED_BYTES = 32 << 20
PRODUCTS = (
    "summary.json", "telemetry.npz", "telemetry.csv", "timing.png", "timeline.png", "evolved.cpp", "log.txt",
)  # fmt: skip


@contextlib.contextmanager
def writing(out: Path) -> Iterator[None]:
    """Names the place when it cannot be written to."""
    try:
        yield
    except OSError as error:
        raise LitheError(
            f"cannot write to {out}: {error.strerror or error}\n"
            "  next: free some space, get the rights, or choose another --out DIR"
        ) from None


def prepare(out: Path) -> None:
    """Room for the results, and none of an earlier run's, so that an old success is never read as a new one."""
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
        for name in PRODUCTS:
            (out / name).unlink(missing_ok=True)
        (out / "log.txt").touch()
        free = shutil.disk_usage(out).free
    if free < NEEDED_BYTES:
        raise LitheError(f"{out} has {free >> 20} MiB left, {NEEDED_BYTES >> 20} are needed: free some, or --out DIR")


def attempt(robot_file: Path, sims: list[SimJoint], out: Path, past: list[dict[str, Any]]) -> dict[str, Any]:
    """One run; `past` gets a line on how it ended."""
    began = time.monotonic()
    story = judge.Story()
    reason = "failed"
    try:
        with Stage(robot_file, out / "log.txt") as stage:
            with recorder.Recorder(stage.robot) as recording:
                records, lost = Experiment(stage, recording, story).run()
            summary = judge.summarise(records, story, sims, stage.spine.info, lost)
        reason = "completed"
    except Disturbed as error:
        reason = error.fault
        raise
    finally:
        phase = story.phases[-1]["name"] if story.phases else "start"
        past.append({"reason": reason, "phase": phase, "seconds": time.monotonic() - began})
    with writing(out):
        (out / "evolved.cpp").write_text(story.source, encoding="utf-8")
        recorder.save(records, out)
        figures.draw(records, story, summary, out)
    return summary


def attempts(robot_file: Path, sims: list[SimJoint], out: Path) -> dict[str, Any]:
    """The first run that the machine did not disturb. Whatever else goes wrong ends the demo at once."""
    past: list[dict[str, Any]] = []
    for number in range(1, TRIES + 1):
        with writing(out), (out / "log.txt").open("a", encoding="utf-8") as log:
            log.write(f"---- run {number} of at most {TRIES}\n")
        print(f"supervised evolution on {robot_file.name}", flush=True)
        try:
            return {**attempt(robot_file, sims, out, past), "attempts": past}
        except Disturbed as error:
            print(f"  {error}; the robot is stopped (run {number} of at most {TRIES})", flush=True)
            time.sleep(PAUSE_S if number < TRIES else 0)
    reasons = ", ".join(f"{one['reason']} in '{one['phase']}'" for one in past)
    raise LitheError(
        f"the machine is too busy: the robot stopped itself in {TRIES} runs ({reasons})\n  next: free a core, run again"
    )


def write_summary(summary: dict[str, Any], out: Path) -> None:
    """All of it or nothing."""
    part = out / "summary.json.part"
    with writing(out):
        try:
            part.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
            part.replace(out / "summary.json")
        finally:
            part.unlink(missing_ok=True)


def leave(*_: object) -> NoReturn:
    """SIGTERM: out through the `with` blocks, so the robot is stopped; once is enough."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.exit(143)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m lithe.demo", description=__doc__)
    parser.add_argument("--robot", type=Path, default=ROOT / "robots/arm.toml", help="any that simulates gravity")
    parser.add_argument("--out", type=Path, default=ROOT / "out/demo")
    parser.add_argument(
        "--over-real-buses",
        action="store_true",
        help="also where motors may hang on the buses: every joint swings, under laws that are bad on purpose",
    )
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, leave)
    try:
        prepare(args.out)
        robot_file = args.robot.resolve()
        sims = simulated_joints(robot_file, args.over_real_buses)
        summary = attempts(robot_file, sims, args.out)
        wrong = judge.verdict(summary)
        summary["verdict"] = "holds" if not wrong else "falls short"
        summary["falls_short"] = wrong
        write_summary(summary, args.out)
        report(summary, args.out)
    except (LitheError, OSError) as error:
        print(f"lithe demo: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("lithe demo: interrupted; the robot is stopped", file=sys.stderr)
        return 130
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
