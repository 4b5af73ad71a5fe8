# SPDX-License-Identifier: Apache-2.0
"""The running Spine under Brains that are killed while they publish: it ticks on, and reads nothing torn.

Each plan stands still at one of three angles, so far apart that the joint could not get from one to the next between
two waypoints: a plan with parts of two is refused as too fast (or, torn in its times, as running backwards), and the
Spine says so in an event. A Brain that ignores the protocol shows that it would.
"""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from calm import calm_robot
from lithe import _wire, place, shm
from lithe._wire import EventKind, Mode, PlanReject
from lithe.demo import losses
from lithe.shm import BrainWriter, SpineView
from segments import channel_slots
from system.robot_rig import ROOT

pytestmark = pytest.mark.alone

BROKEN = 20  # Brains of the control
STUCK_S = 30.0
LONGEST_LIFE_S = 0.04  # after its first plan was accepted
BEFORE_NS, AFTER_NS = 1_000_000, 9_000_000  # of a kill: what it costs the Spine shows here
# A difference this unlikely by chance is none. Five hundred forks and exits are a load of their own: 18 windows of 500
# beside 6 of 863 were seen (p = 1.3e-4). A Spine that waits for its Brain would lose a tick in every window.
SURE = 1e-7
REACH_NS = 200_000_000  # before the middle of three plans begins: the arm gets from any of their angles to any other
SPACING_NS = 20_000_000
STEP_RAD = 0.65  # within SPACING_NS that is 32.5 rad/s: above the arm's 30
NEW_BRAIN = 1_000_000  # plan ids per Brain
# What a plan torn between two good ones can be refused for; too_old is no tear but a Spine that was not running.
TORN = {reject.name for reject in PlanReject} - {"none", "too_old"}


def fill(plan: np.ndarray[Any, Any], plan_id: int) -> None:
    """A plan that differs from the one in the same slot before it, four ids ago, in every number that counts."""
    level = plan_id % 3 - 1
    plan["plan_id"], plan["waypoint_count"], plan["joint_count"] = plan_id, _wire.NW, 1
    plan["t_ns"] = time.monotonic_ns() + REACH_NS + level * 2 * SPACING_NS + SPACING_NS * np.arange(1, _wire.NW + 1)
    plan["position_rad"] = level * STEP_RAD
    plan["velocity_rad_s"] = np.nan


def break_the_protocol(mapping: shm.Mapping, plan: np.ndarray[Any, Any]) -> None:
    """What no writer may do: announce a plan, then write it, word by word."""
    load, store = shm.shim().lithe_load, shm.shim().lithe_store
    address = mapping.item("plan")[1]
    count = load(address) + 1
    slot = channel_slots(mapping, "plan")[count & 3]
    store(slot, 2 * count)
    store(address, count)
    for at, word in enumerate(plan.reshape(1).view(np.uint64).tolist()):
        store(slot + 8 + 8 * at, word)


def publish_forever(robot: str, cpu: int, first_id: int, way: str) -> None:
    """A Brain."""
    place.pin(cpu)
    writer = BrainWriter(robot)
    address = writer.mapping.item("plan")[1]
    plans = np.zeros(30 if way == "hammer" else 1, shm.dtype("Plan"))
    for next_id in range(first_id, first_id + NEW_BRAIN, len(plans)):
        for i in range(len(plans)):
            fill(plans[i : i + 1], next_id + i)
        for i in list(range(len(plans))) * (
            10 if way == "hammer" else 1
        ):  # hardly anything but writes: most kills hit one
            if way == "broken":
                break_the_protocol(writer.mapping, plans[i])
            else:
                shm.shim().lithe_channel_write(address, plans[i : i + 1].ctypes.data, plans.itemsize)
        writer.beat()
        if way == "steady":
            time.sleep(0.001)


class Watch:
    """Follows the Spine from outside while Brains come and go."""

    def __init__(self, robot: str) -> None:
        """Attach; nothing is published yet."""
        self.robot = robot
        self.spine = SpineView(robot)
        self.brain = shm.Mapping(robot, "brain", writable=False)
        self.records = self.spine.telemetry()
        self.events = self.spine.events(from_oldest=False)
        self.kept: list[np.ndarray[Any, Any]] = []
        self.refused: Counter[str] = Counter()
        self.kinds: Counter[str] = Counter()
        self.kills_ns: list[int] = []
        self.accepted = self.left_odd = 0
        self.chance = random.Random(1)

    def look(self) -> np.ndarray[Any, Any]:
        """Takes what is new; the latest record."""
        self.kept.append(self.records.drain())
        for event in self.events.drain():
            kind = EventKind(int(event["kind"])).name
            self.kinds[kind] += 1
            if kind == "plan_refused":
                self.refused[PlanReject(int(event["code"])).name] += 1
        latest = self.spine.latest()
        assert latest is not None
        return latest

    def live_and_kill(self, way: str) -> None:
        """One Brain, from its fork to its end; it is killed when the Spine has followed it for a while."""
        first_id = (self.brain.header().epoch + 1) * NEW_BRAIN
        pid = os.fork()
        if pid == 0:
            try:
                publish_forever(self.robot, int(self.spine.info["cpu_brain"]), first_id, way)
            finally:
                os._exit(1)
        stuck_s = time.monotonic() + STUCK_S
        while int(self.look()["plan_id"]) < first_id:
            assert time.monotonic() < stuck_s, f"Brain {len(self.kills_ns)} was not followed: {self.told()}"
            time.sleep(0.001)
        self.accepted += 1
        time.sleep(self.chance.uniform(0, LONGEST_LIFE_S))
        before = int(self.look()["tick"])
        self.kills_ns.append(time.monotonic_ns())
        os.kill(pid, signal.SIGKILL)
        _, status = os.waitpid(pid, 0)
        assert os.WIFSIGNALED(status), "the Brain ended by itself"
        self.left_odd += sum(shm.shim().lithe_load(at) % 2 for at in channel_slots(self.brain, "plan"))
        while int(self.look()["tick"]) <= before + 1:  # one tick may have been under way
            assert time.monotonic() < stuck_s, f"the Spine stands still since tick {before}"
            time.sleep(0.001)

    def told(self) -> dict[str, Any]:
        """What was seen so far."""
        records = np.concatenate(self.kept)
        return {
            "kills": len(self.kills_ns),
            "accepted": self.accepted,
            "epoch": self.brain.header().epoch,
            "ticks": len(records),
            "records_lost": self.records.lost,
            "events_lost": self.events.lost,
            "gaps": int((np.diff(records["tick"].astype(np.int64)) != 1).sum()),
            "modes": sorted(Mode(int(mode)).name for mode in np.unique(records["mode"])),
            "plans_followed": len(np.unique(records["plan_id"])) - 1,
            "left_odd": self.left_odd,
            "refused": dict(self.refused),
            "events": dict(self.kinds),
        }


def watch(robot: str, kills: int) -> dict[str, Any]:
    """So many honest Brains, then the broken ones."""
    honest = Watch(robot)
    os.sched_setaffinity(
        0, (os.sched_getaffinity(0) - {int(honest.spine.info["cpu_spine"])}) or os.sched_getaffinity(0)
    )
    for brain in range(kills):
        honest.live_and_kill("hammer" if brain % 2 else "steady")
    told = honest.told() | stalls(honest)
    broken = Watch(robot)
    for _ in range(BROKEN):
        broken.live_and_kill("broken")
    told["refused_of_broken"] = dict(broken.refused)
    return told


def stalls(seen: Watch) -> dict[str, Any]:
    """Is a release skipped near a kill more often than elsewhere?"""
    made = losses.releases(np.concatenate(seen.kept), round(1e9 / float(seen.spine.info["rate_hz"])))
    windows = [(kill_ns - BEFORE_NS, kill_ns + AFTER_NS) for kill_ns in seen.kills_ns]
    others = losses.elsewhere((windows[0][0], windows[-1][1]), windows, BEFORE_NS + AFTER_NS)
    compared = losses.compare(made, windows, others)
    return {
        "windows_with_a_lost_tick": f"{compared.at_events} of {compared.events} at a kill, {compared.between} of "
        f"{compared.others} elsewhere; {compared.would_show(SURE)} would have failed",
        "chance": compared.chance,
        "others": compared.others,
    }


def torn(refused: dict[str, int]) -> int:
    """Refusals that only a torn plan explains."""
    return sum(count for reason, count in refused.items() if reason in TORN)


@pytest.mark.parametrize("kills", [200, pytest.param(500, marks=pytest.mark.long)])
def test_a_brain_killed_many_times_while_publishing_harms_nobody(tell: Callable[[str], None], kills: int) -> None:
    """Each new Brain is followed, no tick is lost to a death, nothing torn is read, the arm stays active."""
    # In a process of its own: forking is only clean where no other thread runs.
    paths = {"PYTHONPATH": f"{ROOT / 'brain'}:{ROOT / 'tests'}"}
    with calm_robot():
        command = [sys.executable, __file__, str(kills)]
        done = subprocess.run(command, env=os.environ | paths, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    for name, value in told.items():
        tell(f"{name}: {value}")
    assert told["kills"] == told["accepted"] == told["epoch"] == kills, "each new Brain got the lease and was followed"
    assert (told["records_lost"], told["events_lost"], told["gaps"]) == (0, 0, 0), "all of it was seen"
    assert told["modes"] == ["active"]
    assert told["chance"] >= SURE, told["windows_with_a_lost_tick"]
    assert told["others"] > kills / 4, "there is enough to compare with"
    assert told["plans_followed"] > kills
    assert torn(told["refused"]) == 0, told["refused"]
    # The controls: kills did hit writes, and a plan written without the protocol does get torn, and is seen to be.
    assert told["left_odd"] > 0
    assert torn(told["refused_of_broken"]) > 0, told["refused_of_broken"]


if __name__ == "__main__":
    print(json.dumps(watch("arm", int(sys.argv[1]))))
