# SPDX-License-Identifier: Apache-2.0
"""The experiment itself: follows the agent through its phases, then freezes and kills the Brain."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from typing import Any

import numpy as np

from lithe._wire import Fault, Mode
from lithe.errors import LitheError

from . import brain, judge
from .agent import SINE
from .processes import Disturbed, Lines, Stage, raise_unless_active, start_brain
from .recorder import Recorder

FREEZE_S = 1.5


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
    def __init__(self, stage: Stage, recording: Recorder, story: judge.Story) -> None:
        self.stage = stage
        self.recording = recording
        self.token_file = stage.folder / "token"
        self.story = story
        self.began = time.monotonic()

    def say(self, text: str) -> None:
        record = self.stage.spine.latest()
        missed = 0 if record is None else int(record["missed_releases"])
        print(f"  {time.monotonic() - self.began:5.1f} s  {text:<66} lost ticks {missed}", flush=True)

    def check(self) -> None:
        self.stage.check()
        record = self.stage.spine.latest()
        if record is not None:
            raise_unless_active(Mode(int(record["mode"])).name, Fault(int(record["fault"])).name)

    def wait(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self.check()
            time.sleep(0.02)

    def run(self) -> tuple[Any, int]:
        """All phases; the records and how many were lost."""
        try:
            mind, port = start_brain(self.stage, self.token_file, {})
            self.follow_agent(port)
            self.freeze(mind.pid)
            self.kill(mind)
        except Disturbed:
            raise
        except LitheError:
            self.check()  # the robot's own stop explains what came of it better
            raise
        self.story.end(time.monotonic_ns())
        return self.recording.finish(), self.recording.lost

    def follow_agent(self, port: int) -> None:
        agent = self.stage.start("lithe.demo.agent", "--port", str(port), "--token-file", str(self.token_file))
        lines = Lines(agent)
        while (line := lines.next(0.2)) is not None:
            self.check()
            self.hear(line)
        if agent.wait() != 0:
            raise LitheError(f"the agent ended with code {agent.returncode}:{self.stage.tail()}")

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
        else:
            raise LitheError(
                f"the setpoint did not come down through {np.degrees(angle_rad):.0f} deg within 10 s, "
                "where the Brain is to be frozen"
            )
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
