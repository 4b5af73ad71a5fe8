# SPDX-License-Identifier: Apache-2.0
"""The experiment itself: follows the agent through its phases, then freezes and kills the Brain."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from typing import Any

import numpy as np
import numpy.typing as npt

from lithe._wire import Fault, Mode
from lithe.errors import LitheError
from lithe.gateway import references

from . import judge
from .processes import Disturbed, Stage, next_line, raise_unless_active, start_brain
from .recorder import Recorder

FREEZE_S = 1.5


def freeze_phase_rad(reference: dict[str, Any], decelerations_rad_s2: npt.NDArray[np.float64]) -> float:
    """The phase at which a Brain stopped now lets the setpoints end at half a turn, where gravity pulls hardest.

    What has been published lasts about `ahead_s`; then each setpoint slows down at its joint's deceleration. Of joints
    that differ in that, the mean.
    """
    omega = 2 * np.pi * float(reference["frequency_hz"])
    amplitudes_rad = np.asarray(reference["amplitude_rad"])
    coast_shares = amplitudes_rad * omega**2 / (2 * decelerations_rad_s2)  # of the amplitude
    ahead_s = (references.POINTS - 1) * references.PERIOD_NS * 1e-9
    return float(max(np.pi - np.mean(np.arcsin(np.minimum(1.0, coast_shares))) - omega * ahead_s, np.pi / 2))


def next_at(reference: dict[str, Any], phase_rad: float, after_ns: int) -> int:
    """When the sines come to that phase next, CLOCK_MONOTONIC ns."""
    period_ns = 1e9 / float(reference["frequency_hz"])
    first_ns = int(reference["since_ns"]) + phase_rad / (2 * np.pi) * period_ns
    return int(first_ns + max(0, np.ceil((after_ns - first_ns) / period_ns)) * period_ns)


class Experiment:
    """`agent_words`: more of the agent's command line, such as a language model's server."""

    def __init__(self, stage: Stage, recording: Recorder, story: judge.Story, agent_words: list[str]) -> None:
        self.stage = stage
        self.agent_words = agent_words
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
        agent = self.stage.start(
            "lithe.demo.agent", "--port", str(port), "--token-file", str(self.token_file), *self.agent_words
        )
        while (line := next_line(agent, 0.2)) != b"":
            self.check()
            self.hear(json.loads(line or b"{}"))
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
            self.story.estimates.append(estimate)
            self.say(self.read_aloud(estimate))
        elif reference := line.get("reference"):
            self.story.reference = reference
        elif "source" in line:
            self.story.source = line["source"]
        elif doing := line.get("doing"):
            self.say(f"agent {doing}")

    def read_aloud(self, estimate: dict[str, Any]) -> str:
        name = f" of {estimate['name']}" if self.stage.spine.joint_count > 1 else ""
        if estimate["mgl_hat_nm"] == 0:
            return f"estimate{name}: no gravity, J = {estimate['inertia_hat_kg_m2']:.2e} kg m2"
        least_nm, most_nm = estimate["mgl_interval_nm"]
        return f"estimate{name}: mgl = {estimate['mgl_hat_nm']:.4f} N m, 95 % interval {least_nm:.4f} to {most_nm:.4f}"

    def freeze(self, pid: int) -> None:
        """Stops the Brain so that each joint comes to rest where gravity pulls hardest: horizontal, if it can be."""
        joints = self.stage.spine.joint_count
        decelerations = np.asarray(self.stage.spine.info["deceleration_rad_s2"][:joints], dtype=np.float64)
        phase_rad = freeze_phase_rad(self.story.reference, decelerations)
        at_ns = next_at(self.story.reference, phase_rad, time.monotonic_ns())
        self.wait((at_ns - time.monotonic_ns()) * 1e-9 - 0.02)
        while time.monotonic_ns() < at_ns:
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

    def kill(self, mind: subprocess.Popen[bytes]) -> None:
        mind.kill()
        mind.wait()
        start = time.monotonic_ns()
        self.story.begin("killed", start)
        self.say("the Brain is killed; the robot holds")
        self.wait(1.0)
        self.story.end(time.monotonic_ns())
        start_brain(self.stage, self.token_file, self.story.reference)
        self.story.kill_ns = (start, time.monotonic_ns())
        self.say("a new Brain has attached")
        self.wait(float(self.story.reference["ramp_s"]) + 0.5)
        self.story.begin("reattached", time.monotonic_ns())
        self.wait(3.0)
