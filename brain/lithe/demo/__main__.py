# SPDX-License-Identifier: Apache-2.0
"""Runs the supervised-evolution experiment and judges it: `make demo`.

Four phases on a simulated one-joint arm that answers real moteus frames: baseline, probing, evolution, fault tolerance.
Exit code 0 when the claim holds, 1 when it does not or something broke.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from lithe._wire import Fault, Mode
from lithe.errors import LitheError

from . import brain, figures, judge, recorder
from .agent import SINE, UNCLEAR
from .processes import ROOT, Lines, Stage, start_brain

FREEZE_S = 1.5
TRIES = 3
NEEDED_BYTES = 32 << 20


class Disturbed(LitheError):
    """The robot left its mode, and not by the experiment's doing: the machine took its core away for too long."""


def freeze_angle_rad(deceleration_rad_s2: float) -> float:
    """Where on its way down the sine's setpoint is when a Brain stopped now lets it end at the centre.

    What has been published lasts about `ahead_s`; then the setpoint slows down at the joint's deceleration.
    """
    omega = 2 * np.pi * SINE["frequency_hz"]
    speed_rad_s = SINE["amplitude_rad"] * omega
    coast_rad = speed_rad_s**2 / (2 * deceleration_rad_s2)
    ahead_s = (brain.POINTS - 1) * brain.PERIOD_NS * 1e-9
    phase_rad = np.pi - np.arcsin(min(1.0, coast_rad / SINE["amplitude_rad"])) - omega * ahead_s
    return float(SINE["centre_rad"] + SINE["amplitude_rad"] * np.sin(max(phase_rad, np.pi / 2)))


class Experiment:
    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        self.token_file = stage.folder / "token"
        self.story = judge.Story()
        self.began = time.monotonic()
        self.recorder = recorder.Recorder(self.stage.robot)

    def say(self, text: str) -> None:
        record = self.stage.spine.latest()
        missed = 0 if record is None else int(record["missed_releases"])
        print(f"  {time.monotonic() - self.began:5.1f} s  {text:<66} lost ticks {missed}", flush=True)

    def check(self) -> None:
        record = self.stage.spine.latest()
        if record is not None and int(record["mode"]) != Mode.active:
            fault = Fault(int(record["fault"])).name
            raise Disturbed(f"safe stop ({fault}): the machine took the robot's core away for too long")

    def wait(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self.check()
            time.sleep(0.02)

    def run(self) -> tuple[Any, int]:
        """All phases; the records and how many were lost."""
        mind, port = start_brain(self.stage, self.token_file, {})
        self.follow_agent(port)
        self.freeze(mind.pid)
        self.kill(mind)
        self.story.end(time.monotonic_ns())
        return self.recorder.finish(), self.recorder.lost

    def follow_agent(self, port: int) -> None:
        agent = self.stage.start("lithe.demo.agent", "--port", str(port), "--token-file", str(self.token_file))
        lines = Lines(agent)
        while (line := lines.next(0.2)) is not None:
            self.check()
            self.hear(line)
        if agent.wait() == UNCLEAR:
            raise Disturbed("the agent could make nothing of its measurements: too many ticks were lost")
        if agent.returncode != 0:
            raise LitheError(f"the agent ended with code {agent.returncode}; see the log")

    def hear(self, line: dict[str, Any]) -> None:
        if line.get("phase") == "":
            self.story.end(line["from_ns"])
        elif phase := line.get("phase"):
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
            self.say(f"agent {doing}")

    def freeze(self, pid: int) -> None:
        """Stops the Brain so that the arm comes to rest horizontal, where gravity pulls hardest."""
        angle_rad = freeze_angle_rad(float(self.stage.spine.info["deceleration_rad_s2"][0]))
        before = -np.inf
        deadline = time.monotonic() + 10
        while time.monotonic() < deadline:
            self.check()
            record = self.stage.spine.latest()
            now = before if record is None else float(record["setpoint_position_rad"][0])
            if before >= angle_rad > now:  # on its way down
                break
            before = now
            time.sleep(0.001)
        os.kill(pid, signal.SIGSTOP)
        start = time.monotonic_ns()
        self.story.begin("frozen", start)
        self.say("phase: fault tolerance; the Brain is frozen under full gravity load")
        try:
            self.wait(FREEZE_S)
        finally:
            os.kill(pid, signal.SIGCONT)
        self.story.freeze_ns = (start, time.monotonic_ns())
        self.story.end(self.story.freeze_ns[1])
        self.say("the Brain goes on")
        self.wait(1.0)
        self.story.begin("resumed", time.monotonic_ns())
        self.wait(3.0)

    def kill(self, mind: subprocess.Popen[str]) -> None:
        mind.kill()
        mind.wait()
        start = time.monotonic_ns()
        self.story.begin("killed", start)
        self.say("the Brain is killed; the arm holds")
        self.wait(1.0)
        self.story.end(time.monotonic_ns())
        start_brain(self.stage, self.token_file, SINE)
        self.story.kill_ns = (start, time.monotonic_ns())
        self.say("a new Brain has attached")
        self.wait(float(SINE["ramp_s"]) + 0.5)
        self.story.begin("reattached", time.monotonic_ns())
        self.wait(3.0)


def attempt(robot_file: Path, out: Path) -> dict[str, Any]:
    with Stage(robot_file, out / "log.txt") as stage:
        experiment = Experiment(stage)
        records, lost = experiment.run()
        config = tomllib.loads(robot_file.read_text(encoding="utf-8"))
        mgl_true = float(config["joint"][0]["sim"]["mgl_nm"])  # the judge may know it; the agent does not
        summary = judge.summarise(records, experiment.story, mgl_true, stage.spine.info, lost)
    (out / "evolved.cpp").write_text(experiment.story.source, encoding="utf-8")
    recorder.save(records, out)
    figures.draw(records, experiment.story, summary, out)
    return summary


def attempts(robot_file: Path, out: Path) -> dict[str, Any]:
    """The first run that the machine did not disturb."""
    for number in range(1, TRIES + 1):
        print(f"supervised evolution on {robot_file.name}", flush=True)
        try:
            return attempt(robot_file, out)
        except Disturbed as error:
            print(f"  {error}; the robot is stopped and the run repeated ({number} of {TRIES})", flush=True)
    raise LitheError(f"the machine is too busy: the robot stopped itself in {TRIES} runs; free a core and run again")


def check_space(out: Path) -> None:
    """Better now than after the run."""
    out.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(out).free
    if free < NEEDED_BYTES:
        raise LitheError(f"{out} has {free >> 20} MiB left, {NEEDED_BYTES >> 20} are needed: free some, or --out DIR")


def report(summary: dict[str, Any], out: Path) -> None:
    print()
    for phase in summary["phases"]:
        print(f"  {phase['name']:<12} RMSE {phase['rmse_deg']:7.2f} deg   ({phase['seconds']:.1f} s)")
    print(
        f"  mgl         {summary['mgl_hat_nm']:.4f} N m estimated, {summary['mgl_true_nm']:.4f} true: "
        f"off by {summary['mgl_error']:.1%}"
    )
    for swap in summary["swaps"]:
        print(
            f"  swap        {swap['law']:<12} compiled in {swap['compile_ms']:4.0f} ms, tick {swap['commit_tick']}, "
            f"torque step {swap['output_step_nm']:.4f} N m, "
            f"lost ticks {swap['lost_ticks_prepare']} preparing, {swap['lost_ticks_commit']} around the commit"
        )
    for name, key in (
        ("swaps", "swap_windows"), ("commits", "commit_windows"), ("elsewhere", "no_swap_windows")
    ):  # fmt: skip
        tally = summary[key]
        print(
            f"  {name:<11} {tally['lost_per_s']:.2f} lost ticks a second: "
            f"{tally['lost_ticks']} in {tally['seconds']:.1f} s, "
            f"in {tally['windows_with_loss']} of {tally['windows']} windows"
        )
    print(
        f"  by accident commits lose as much with probability {summary['swap_loss_chance']:.2g} "
        f"(below {judge.LEAST_CHANCE} they are guilty)"
    )
    freeze = summary["freeze"]
    print(
        f"  freeze      {freeze['duration_s']:.2f} s, at rest at {freeze['rest_angle_deg']:.0f} deg; "
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
    print(
        f"  machine     {machine['cpu']}, {machine['cores']} cores, Linux {machine['kernel']}, {machine['privileges']}"
    )
    if machine["lost"]:
        print(f"  this machine cannot give: {machine['lost']}")
    print(f"  figures and telemetry in {out}/")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m lithe.demo", description=__doc__)
    parser.add_argument("--robot", type=Path, default=ROOT / "robots/arm.toml")
    parser.add_argument("--out", type=Path, default=ROOT / "out/demo")
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # through the `with` blocks: the robot is stopped
    try:
        check_space(args.out)
        summary = attempts(args.robot.resolve(), args.out)
        wrong = judge.verdict(summary)
        summary["verdict"] = "holds" if not wrong else "falls short"
        summary["falls_short"] = wrong
        (args.out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    except LitheError as error:
        print(f"lithe demo: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(
            f"lithe demo: cannot write to {args.out}: {error.strerror}; the robot is stopped\n"
            "  next: free some space or rights, or choose another --out DIR",
            file=sys.stderr,
        )
        return 1
    except KeyboardInterrupt:
        print("lithe demo: interrupted; the robot is stopped", file=sys.stderr)
        return 130
    report(summary, args.out)
    for sentence in wrong:
        print(f"  FALLS SHORT: {sentence}")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
