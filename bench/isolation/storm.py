# SPDX-License-Identifier: Apache-2.0
"""A robot whose laws are swapped without pause: `python -m bench.isolation.storm FOLDER SECONDS`. Ends at SIGINT.

Every law has a new comment, so each swap has a real compilation, admission, trial and placement.
"""

import contextlib
import os
import shutil
import sys
import time
from itertools import count
from pathlib import Path

import lithe
from lithe.programs import ROOT

from bench.isolation.loads import SWAPS
from bench.swap.robot import running, wake

LAWS = [ROOT / "laws/pd.cpp", ROOT / "bench/swap/laws/pi_lowpass.cpp"]


def main(folder: Path, most_s: float) -> None:
    """Swap until the time is over."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    until, done = time.monotonic() + most_s, 0
    core = str(min(os.sched_getaffinity(0)))  # the Brain's: none of the robot is on the measured core
    cores = dict.fromkeys(("cpu_spine", "cpu_transport", "cpu_brain", "cpu_housekeeping"), core)
    with running(folder, release='"sleep"', **cores) as robot:
        for number in count():
            if time.monotonic() > until:
                break
            wake(robot)
            source = LAWS[number % len(LAWS)]
            try:
                robot.swap(f"{source.read_text(encoding='utf-8')}// {time.time_ns()}\n", name=source.name)
            except lithe.Refused:
                continue  # a busy machine may make a trial late; the load continues
            done += 1
            print(f"{done} {SWAPS}", flush=True)


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main(Path(sys.argv[1]), float(sys.argv[2]))
