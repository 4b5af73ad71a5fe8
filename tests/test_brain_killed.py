# SPDX-License-Identifier: Apache-2.0
"""A Brain that dies at any moment of its publishing leaves no torn plan, no stuck reader and no lost lease."""

import ctypes
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from lithe import _wire, shm
from lithe.shm import BrainWriter
from segments import channel_slots, make_file, own_prefix, remove

ROOT = Path(__file__).resolve().parents[1]
KILLS = 500
STUCK_S = 20.0


def publish_forever(robot: str, first_id: int, through_shim: bool) -> None:
    """A Brain: every number of a plan is its id, so that a torn one shows."""
    writer = BrainWriter(robot)
    address = writer.mapping.item("plan")[1]
    plan = np.zeros((), shm.dtype("Plan"))
    numbers = np.zeros((_wire.NW, _wire.NJ))
    times = np.zeros(_wire.NW, np.int64)
    plan_id = first_id
    while True:
        if through_shim:  # nothing but the write: most kills hit the middle of one
            plan["plan_id"] = plan["t_ns"][:] = plan["position_rad"][:] = plan["velocity_rad_s"][:] = plan_id
            for _ in range(100):
                shm.shim().lithe_channel_write(address, plan.ctypes.data, plan.nbytes)
        else:
            numbers[:] = times[:] = plan_id
            writer.publish(plan_id, times, numbers, numbers)
        plan_id += 1


def is_whole(plan: np.ndarray) -> bool:
    """All its numbers are its id."""
    plan_id = plan["plan_id"]
    return all(bool((plan[name] == plan_id).all()) for name in ("t_ns", "position_rad", "velocity_rad_s"))


def half_written(mapping: shm.Mapping) -> tuple[int, int]:
    """How many slots a dead writer left odd, and how many of those hold parts of two plans."""
    odd = torn = 0
    for at in channel_slots(mapping, "plan"):
        if shm.shim().lithe_load(at) % 2 == 1:
            plan = np.zeros((), shm.dtype("Plan"))
            ctypes.memmove(plan.ctypes.data, at + 8, plan.nbytes)
            odd += 1
            torn += not is_whole(plan)
    return odd, torn


def watch(robot: str, kills: int) -> dict[str, int]:
    """Starts and kills one Brain after the other, and reads all the while."""
    reader = shm.Mapping(robot, "brain", writable=False)
    chance = random.Random(1)
    told = {"kills": 0, "reads": 0, "torn": 0, "gave_up": 0, "back": 0, "died_in_mid_write": 0, "torn_in_memory": 0}
    seen = newest_id = 0
    for round_number in range(kills):
        first_id = newest_id + 1
        brain = os.fork()
        if brain == 0:
            try:
                publish_forever(robot, first_id, through_shim=round_number % 2 == 1)
            finally:
                os._exit(1)
        stuck_at = time.monotonic() + STUCK_S
        end = None
        while end is None or time.monotonic() < end:
            entry = reader.channel("plan")
            if entry is None:
                told["gave_up"] += seen != 0
            else:
                count, plan = entry
                told["reads"] += 1
                told["torn"] += not is_whole(plan)
                told["back"] += count < seen
                seen, newest_id = count, int(plan["plan_id"])
            if end is None and newest_id >= first_id:  # the new Brain has published
                end = time.monotonic() + chance.uniform(0, 0.002)
            assert time.monotonic() < stuck_at, f"nothing from Brain {round_number}: {told}"
        os.kill(brain, signal.SIGKILL)
        _, status = os.waitpid(brain, 0)
        assert os.WIFSIGNALED(status), "the Brain ended by itself"
        last = reader.channel("plan")  # what it published after our last look
        assert last is not None
        seen, newest_id = last[0], int(last[1]["plan_id"])
        odd, torn = half_written(reader)
        told["died_in_mid_write"] += odd
        told["torn_in_memory"] += torn
        told["kills"] += 1
    told["epoch"] = reader.header().epoch
    return told


def test_a_brain_killed_500_times_while_publishing_harms_no_reader(tell: Callable[[str], None]) -> None:
    # In a process of its own: forking is only clean where no other thread runs.
    threads = {f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "OMP", "MKL")}
    paths = {"PYTHONPATH": f"{ROOT / 'brain'}:{ROOT / 'tests'}"}
    env = os.environ | threads | paths
    done = subprocess.run([sys.executable, __file__], env=env, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    tell(json.dumps(told))
    assert told["kills"] == told["epoch"] == KILLS, "each new Brain got the lease"
    assert (told["torn"], told["back"]) == (0, 0), told
    assert told["reads"] > KILLS
    assert told["gave_up"] < told["reads"] / 100, "four tries nearly always suffice"
    # The control: the kills did hit writes, and did leave in memory what no reader was given.
    assert told["died_in_mid_write"] > 0, told
    assert told["torn_in_memory"] > 0, told


if __name__ == "__main__":
    os.environ["LITHE_SHM_PREFIX"] = own_prefix()
    make_file("arm", "brain")
    try:
        print(json.dumps(watch("arm", KILLS)))
    finally:
        remove("arm")
