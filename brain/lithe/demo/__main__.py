# SPDX-License-Identifier: Apache-2.0
"""Runs the supervised-evolution experiment and judges it: `make demo`.

Four phases on a simulated one-joint arm that answers real moteus frames: baseline, probing, evolution, fault tolerance.
Exit code 0 when the claim holds, 1 when it does not or something broke.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from lithe.errors import LitheError

from . import figures, judge, recorder
from .agent import SINE
from .processes import ROOT, Lines, Stage, start_brain

FREEZE_S = 1.5
ACTIVE = 1
TRIES = 3


class Disturbed(LitheError):
    """The robot left its mode, and not by the experiment's doing: the machine took its core away for too long."""


class Experiment:
    def __init__(self, robot_file: Path, out: Path) -> None:
        self.robot_file = robot_file
        self.stage = Stage(robot_file, out / "log.txt")
        self.token_file = self.stage.folder / "token"
        self.story = judge.Story()
        self.began = time.monotonic()
        self.recorder = recorder.Recorder(self.stage.robot)

    def say(self, text: str) -> None:
        record = self.stage.spine.latest()
        missed = 0 if record is None else int(record["missed_releases"])
        print(f"  {time.monotonic() - self.began:5.1f} s  {text:<66} lost ticks {missed}", flush=True)

    def check(self) -> None:
        if self.stage.mode() != ACTIVE:
            record = self.stage.spine.latest()
            raise Disturbed(f"the robot stopped itself (fault {0 if record is None else int(record['fault'])})")

    def wait(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self.check()
            time.sleep(0.02)

    def run(self) -> tuple[Any, int]:
        """All phases; the records and how many were lost."""
        brain, port = start_brain(self.stage, self.token_file, {})
        self.follow_agent(port)
        self.freeze(brain.pid)
        self.kill(brain)
        self.story.end(time.monotonic_ns())
        return self.recorder.finish(), self.recorder.lost

    def follow_agent(self, port: int) -> None:
        agent = self.stage.start("lithe.demo.agent", "--port", str(port), "--token-file", str(self.token_file))
        lines = Lines(agent)
        while (line := lines.next(0.2)) is not None:
            self.check()
            self.hear(line)
        if agent.wait() != 0:
            raise LitheError(f"the agent ended with code {agent.returncode}; see the log")

    def hear(self, line: dict[str, Any]) -> None:
        if phase := line.get("phase"):
            if phase == "done":
                self.story.end(line["from_ns"])
                return
            self.story.begin(phase, line["from_ns"])
            self.say(f"phase: {phase}")
        elif swap := line.get("swap"):
            self.story.swaps.append(swap)
            self.say(
                f"law '{swap['law']}' compiled in {swap['compile_ms']:.0f} ms, runs from tick {swap['commit_tick'] + 1}"
            )
        elif estimate := line.get("estimate"):
            self.story.estimate = estimate
            self.say(f"estimate: mgl = {estimate['mgl_hat_nm']:.4f} +- {estimate['mgl_se_nm']:.4f} N m")
        elif "source" in line:
            self.story.source = line["source"]
        elif doing := line.get("doing"):
            if "sent_ns" in line:
                self.story.sent_ns.append(line["sent_ns"])
            self.say(f"agent {doing}")

    def freeze(self, pid: int) -> None:
        """Stops the Brain with the arm horizontal, where gravity pulls hardest."""
        deadline = time.monotonic() + 10
        while time.monotonic() < deadline:
            self.check()
            record = self.stage.spine.latest()
            if record is not None and abs(float(record["position_rad"][0]) - np.pi / 2) < 0.05:
                break
            time.sleep(0.002)
        os.kill(pid, signal.SIGSTOP)
        start = time.monotonic_ns()
        self.story.begin("frozen", start)
        self.say("phase: fault tolerance; the Brain is frozen under full gravity load")
        try:
            self.wait(FREEZE_S)
        finally:
            os.kill(pid, signal.SIGCONT)
        self.story.freeze_ns = (start, time.monotonic_ns())
        self.say("the Brain goes on")
        self.wait(1.0)
        self.story.begin("resumed", time.monotonic_ns())
        self.wait(3.0)

    def kill(self, brain: Any) -> None:
        brain.kill()
        brain.wait()
        start = time.monotonic_ns()
        self.story.begin("killed", start)
        self.say("the Brain is killed; the arm holds")
        self.wait(1.0)
        start_brain(self.stage, self.token_file, SINE)
        self.story.kill_ns = (start, time.monotonic_ns())
        self.say("a new Brain has attached")
        self.wait(float(SINE["ramp_s"]) + 0.5)
        self.story.begin("reattached", time.monotonic_ns())
        self.wait(3.0)


def attempt(robot_file: Path, out: Path) -> dict[str, Any]:
    experiment = Experiment(robot_file, out)
    try:
        records, lost = experiment.run()
        info = experiment.stage.spine.info
        config = tomllib.loads(robot_file.read_text(encoding="utf-8"))
        mgl_true = float(config["joint"][0]["sim"]["mgl_nm"])  # the judge may know it; the agent does not
        summary = judge.summarise(records, experiment.story, mgl_true, info, lost)
        (out / "evolved.cpp").write_text(experiment.story.source, encoding="utf-8")
        recorder.save(records, out)
        figures.draw(records, experiment.story, summary, out)
    finally:
        experiment.stage.close()
    return summary


def report(summary: dict[str, Any], out: Path) -> None:
    print()
    for phase in summary["phases"]:
        print(f"  {phase['name']:<11} RMSE {phase['rmse_deg']:7.2f} deg   ({phase['seconds']:.1f} s)")
    print(
        f"  mgl         {summary['mgl_hat_nm']:.4f} N m estimated, {summary['mgl_true_nm']:.4f} true: "
        f"off by {summary['mgl_error']:.1%}"
    )
    for swap in summary["swaps"]:
        print(
            f"  swap        {swap['law']:<12} compiled in {swap['compile_ms']:4.0f} ms, tick {swap['commit_tick']}, "
            f"lost ticks {swap['lost_ticks']}, torque step {swap['output_step_nm']:.4f} N m"
        )
    other = summary["no_swap_windows"]
    print(f"  elsewhere   {other['lost_ticks']} lost ticks in {other['windows']} windows without a swap")
    freeze = summary["freeze"]
    print(
        f"  freeze      {freeze['duration_s']:.2f} s at {freeze['angle_deg']:.0f} deg, "
        f"largest excursion {freeze['max_excursion_deg']:.2f} deg"
    )
    for name, key in (("hand-off", "handoff_us"), ("jitter", "release_jitter_us")):
        q = summary[key]
        print(f"  {name:<11} p50 {q['p50']:.2f}  p99 {q['p99']:.2f}  p99.9 {q['p999']:.2f}  max {q['max']:.2f} us")
    print(
        f"  ticks       {summary['ticks']}, lost {summary['lost_ticks']}, "
        f"missed deadlines {summary['missed_deadlines']}"
    )
    machine = summary["machine"]
    print(f"  machine     {machine['cpu']}, {machine['cores']} cores, Linux {machine['kernel']}, {machine['user']}")
    if machine["lost"]:
        print(f"  this machine cannot give: {machine['lost']}")
    print(f"  figures and telemetry in {out}/")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m lithe.demo", description=__doc__)
    parser.add_argument("--robot", type=Path, default=ROOT / "robots/arm.toml")
    parser.add_argument("--out", type=Path, default=ROOT / "out/demo")
    args = parser.parse_args()
    try:
        args.out.mkdir(parents=True, exist_ok=True)
        for number in range(1, TRIES + 1):
            print(f"supervised evolution on {args.robot.name}", flush=True)
            try:
                summary = attempt(args.robot.resolve(), args.out)
                break
            except Disturbed as error:
                print(f"  {error}: the run is repeated ({number} of {TRIES})", flush=True)
        else:
            raise LitheError(
                "the machine is too busy: the robot stopped itself in every try; free a core and run again"
            )
        wrong = judge.verdict(summary)
        summary["verdict"] = "holds" if not wrong else "falls short"
        summary["falls_short"] = wrong
        (args.out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    except (LitheError, OSError) as error:
        print(f"lithe demo: {error}", file=sys.stderr)
        return 1
    report(summary, args.out)
    for sentence in wrong:
        print(f"  FALLS SHORT: {sentence}")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
