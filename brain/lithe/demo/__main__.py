# SPDX-License-Identifier: Apache-2.0
"""Runs the supervised-evolution experiment and judges it: `make demo`.

Four phases on a simulated robot that answers real frames of its drives: baseline, probing, evolution, fault tolerance.
The verdict is in summary.json and in the exit code: 0 the claim holds, 1 it falls short or something broke (2: wrong
arguments), 4 INCONCLUSIVE: the machine disturbed the run too much to tell, and the kernel's own counts say so.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import json
import os
import shutil
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

from lithe.errors import LitheError

from ..programs import ROOT
from . import figures, judge, recorder, verdict
from .experiment import Experiment
from .joints import SimJoint, simulated_joints, with_truth
from .processes import Disturbed, Stage
from .report import report, report_stop

NEEDED_BYTES = 32 << 20
LOCK = ".lock"  # the Makefile asks for it, too, before it builds
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


@contextlib.contextmanager
def alone_in(out: Path) -> Iterator[None]:
    """Two demos would write into each other's log and results: the second is refused, and touches nothing."""
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
        lock = os.open(out / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise LitheError(
                f"another demo writes to {out}\n  next: wait for it, or choose another --out DIR"
            ) from None
        yield
    finally:
        os.close(lock)


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


def run(robot_file: Path, sims: list[SimJoint], out: Path, agent_words: list[str]) -> dict[str, Any]:
    """The experiment, once; the summary with its verdict. A robot that stopped itself ends it, with a verdict too."""
    print(f"supervised evolution on {robot_file.name}", flush=True)
    story = judge.Story()
    with Stage(robot_file, out / "log.txt") as stage, recorder.Recorder(stage.robot) as recording:
        info = stage.spine.info
        try:
            records, lost = Experiment(stage, recording, story, agent_words).run()
        except Disturbed as stop:
            records = recording.finish()
            if not len(records):
                raise
            phase = story.phases[-1]["name"] if story.phases else "start"
            period_ns = round(1e9 / float(info["rate_hz"]))
            told = verdict.of_stop(records, recording.evidence(), stop.fault, phase, period_ns)
            return told | {"machine": judge.machine(info)}
        summary = judge.summarise(records, story, sims, info, lost, recording.evidence())
    with writing(out):
        (out / "evolved.cpp").write_text(story.source, encoding="utf-8")
        recorder.save(records, out)
        figures.draw(records, story, summary, out)
    return summary | verdict.verdict(summary).told()


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
    parser.add_argument("--llm-url", help="a language model's server: it writes the laws (docs/agents.md)")
    parser.add_argument("--model", help="the model's name")
    args = parser.parse_args()
    if (args.llm_url is None) is not (args.model is None):
        parser.error("a language model needs both: --llm-url URL --model NAME")
    if args.llm_url is not None and not (args.llm_url and args.model):
        parser.error("make demo AGENT=llm LLM_URL=http://127.0.0.1:11434 MODEL=qwen2.5-coder:7b")
    transcripts = str((args.out / "../agent").resolve())
    words = ["--url", args.llm_url, "--model", args.model, "--out", transcripts] if args.llm_url else []
    signal.signal(signal.SIGTERM, leave)
    os.umask(os.umask(0o027) | 0o027)  # logs and laws are not for every user of this machine
    try:
        with alone_in(args.out):
            robot_file = args.robot.resolve()
            sims = with_truth(robot_file, simulated_joints(robot_file, args.over_real_buses))
            prepare(args.out)  # a wrong robot file costs no earlier results
            summary = run(robot_file, sims, args.out, words)
            write_summary(summary, args.out)
            (report_stop if "stopped" in summary else report)(summary, args.out)
    except (LitheError, OSError) as error:
        print(f"lithe demo: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("lithe demo: interrupted; the robot is stopped", file=sys.stderr)
        return 130
    return verdict.WORDS[summary["verdict"]]


if __name__ == "__main__":
    raise SystemExit(main())
