# SPDX-License-Identifier: Apache-2.0
"""The jitter of the real process: `lithe run robots/arm.toml` with the demo's Brain, from the Spine's own histograms.

No other block can alternate with it, and the stolen time of a single release is not visible from outside, so
these figures are raw. The negative control runs another busy thread on the Spine's core. Prints one JSON line.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from lithe._wire import Mode
from lithe.demo.evidence import made_to_wait, stolen_ticks
from lithe.demo.processes import DIE_WITH_US, Stage, start_brain
from lithe.programs import ROOT

SETTLE_S = 2.0
RUN_S = 30.0
CONTROL_S = 5.0
CONTROL_AT_LEAST = 3.0
LEAST_US = 1.0  # smaller differences are not significant
SINE = {"kind": "sine", "centre_rad": 0.0, "amplitude_rad": 0.5, "frequency_hz": 0.5}
Bins = npt.NDArray[np.uint64]


def bin_top_us(number: int) -> float:
    """Longest duration in a bin; the bins are those of spine/core/histogram.hpp."""
    if number < 32:
        return number / 1e3
    octave, within = divmod(number + 1 - 32, 32)
    return (((32 + within) << octave) - 1) / 1e3


def quantile_us(bins: Bins, q: float) -> float:
    """The duration that the fraction q of all releases did not exceed, to the upper edge of its bin."""
    wanted = int(q * (int(bins.sum()) - 1)) + 1
    return bin_top_us(int(np.searchsorted(np.cumsum(bins), wanted)))


def quantiles(key: str, bins: Bins) -> dict[str, float]:
    """p50, p99, p99.9 and max."""
    named = {"p50": 0.5, "p99": 0.99, "p999": 0.999, "max": 1.0}
    return {f"{key}_{name}_us": quantile_us(bins, q) for name, q in named.items()}


class Probe:
    """What happened to the Spine and its core since start()."""

    def __init__(self, stage: Stage) -> None:
        """Start counting."""
        self.stage = stage
        self.cpu = int(stage.spine.info["cpu_spine"])
        self.pid = int(stage.spine.mapping.header().writer_pid)
        self.tid = int(stage.spine.info["tid_spine"])
        self.start()

    def start(self) -> None:
        """Count from now on."""
        spine = self.stage.spine
        self.jitter, self.handoff = spine.histogram("release_jitter"), spine.histogram("handoff")
        self.stolen, self.total = stolen_ticks(self.cpu)
        self.switches = made_to_wait(self.pid, self.tid)
        self.looks = self.inactive = 0

    def wait(self, seconds: float) -> None:
        """Wait, and check meanwhile that the robot is active."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            time.sleep(0.1)
            record = self.stage.spine.latest()
            self.looks += 1
            self.inactive += record is None or int(record["mode"]) != Mode.active

    def figures(self) -> dict[str, Any]:
        """The distributions, and the disturbances."""
        spine = self.stage.spine
        jitter = spine.histogram("release_jitter") - self.jitter
        handoff = spine.histogram("handoff") - self.handoff
        stolen, total = stolen_ticks(self.cpu)
        releases, ticks = int(jitter.sum()), int(handoff.sum())
        return {
            **quantiles("run_release_jitter", jitter),
            **quantiles("run_handoff", handoff),
            "run_releases": releases,
            "run_skipped_releases": releases - ticks,
            "run_stolen_share": (stolen - self.stolen) / max(total - self.total, 1),
            "run_preempted_share": (made_to_wait(self.pid, self.tid) - self.switches) / max(ticks, 1),
            "run_inactive_share": self.inactive / max(self.looks, 1),
        }


def control(probe: Probe) -> dict[str, float]:
    """The same with another busy thread on the Spine's core."""
    command = [*DIE_WITH_US, "taskset", "-c", str(probe.cpu), sys.executable, "-c", "while True: pass"]
    competitor = subprocess.Popen(command, start_new_session=True)
    try:
        time.sleep(0.5)
        probe.start()
        probe.wait(CONTROL_S)
        return quantiles("run_control", probe.stage.spine.histogram("release_jitter") - probe.jitter)
    finally:
        competitor.kill()
        competitor.wait()


def main() -> None:
    """Measure and print the line."""
    with tempfile.TemporaryDirectory() as name, Stage(ROOT / "robots/arm.toml", Path(name) / "run.log") as stage:
        start_brain(stage, Path(name) / "token", SINE)
        time.sleep(SETTLE_S)
        probe = Probe(stage)
        probe.wait(RUN_S)
        told = probe.figures()
        told |= control(probe)
    ratio = max(told["run_control_p999_us"], LEAST_US) / max(told["run_release_jitter_p999_us"], LEAST_US)
    told |= {"run_control_over_run": ratio, "run_control_failed_as_it_must": ratio >= CONTROL_AT_LEAST}
    print(json.dumps(told))


if __name__ == "__main__":
    main()
