# SPDX-License-Identifier: Apache-2.0
"""A Brain that streams goes on while its robot is stopped, or pauses: then the arm is far from the stream.

Setpoint and joint come back to the stream within the velocity limit of the robot file. A robot whose file permits ten
times that speed is the broken twin: the same checks refuse it.
"""

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import lithe
import numpy as np
import numpy.typing as npt
import pytest
from calm import calm_robot, connected
from lithe._wire import Mode
from lithe.demo.recorder import Recorder
from system.robot_rig import RobotRig

LIMIT_RAD_S = 3.0
# A joint may pass its limit a little: in all runs of tests/limits it stays below 0.85 of the speed that is a fault.
JOINT_RAD_S = 0.85 * 1.25 * LIMIT_RAD_S
AMPLITUDE_RAD, FREQUENCY_HZ = 1.2, 0.25  # at most 1.9 rad/s: the stream itself is within the limit
FAR_RAD = 0.9
STALL_S = 4.0
SLOW = {"velocity_max_rad_s = 30.0 ": f"velocity_max_rad_s = {LIMIT_RAD_S} "}
TWIN = {"deceleration_rad_s2 = 20.0 ": "deceleration_rad_s2 = 1000.0 "}  # and 30 rad/s, as the file has it


def angle_rad(t_ns: int) -> float:
    """Where the stream is."""
    return AMPLITUDE_RAD * math.sin(2 * math.pi * FREQUENCY_HZ * t_ns * 1e-9)


class Stream:
    """Publishes half a second of waypoints every 20 ms, whatever the robot does."""

    def __init__(self, robot: lithe.Robot) -> None:
        """Begin."""
        self.robot = robot
        self.over, self.stalled = threading.Event(), threading.Event()
        self.thread = threading.Thread(target=self._publish)
        self.thread.start()

    def _publish(self) -> None:
        while not self.over.wait(0.02):
            if not self.stalled.is_set():
                times_ns = [time.monotonic_ns() + 40_000_000 * (k + 1) for k in range(12)]
                self.robot.publish(times_ns, [angle_rad(t_ns) for t_ns in times_ns])

    def gap_rad(self, field: str) -> float:
        """From where the robot is, or its setpoint, to the stream."""
        record = self.robot.telemetry.latest()
        assert record is not None
        return abs(angle_rad(time.monotonic_ns()) - float(record[field][0]))

    def wait_until_followed(self) -> None:
        """The setpoint is on the stream, and stays there."""
        near: list[bool] = []

        def stays() -> bool:
            near.append(self.gap_rad("setpoint_position_rad") < 0.05)
            return len(near) > 25 and all(near[-25:])

        RobotRig.wait_for(stays)


@contextmanager
def streaming(robot: lithe.Robot) -> Iterator[Stream]:
    """A stream that the robot follows."""
    stream = Stream(robot)
    try:
        stream.wait_until_followed()
        yield stream
    finally:
        stream.over.set()
        stream.thread.join()


def arm_far_away(robot: lithe.Robot, stream: Stream) -> None:
    """E-stop, reset, and arm when the stream is far from the arm, which hangs down."""
    robot.estop()
    robot.reset()
    RobotRig.wait_for(lambda: abs(float(robot.telemetry.latest()["velocity_rad_s"][0])) < 0.05)
    RobotRig.wait_for(lambda: stream.gap_rad("position_rad") > FAR_RAD)
    robot.arm()
    stream.wait_until_followed()


def stall(_robot: lithe.Robot, stream: Stream) -> None:
    """The publisher pauses, and goes on when its stream is far from where the setpoint has come to rest."""
    stream.stalled.set()
    time.sleep(STALL_S)
    RobotRig.wait_for(lambda: stream.gap_rad("setpoint_position_rad") > FAR_RAD)
    stream.stalled.clear()
    stream.wait_until_followed()


def speeds(changes: dict[str, str], story: Callable[[lithe.Robot, Stream], None]) -> tuple[float, float, float]:
    """The greatest speeds of the story [rad/s]: the setpoint's as told, as its angles say, and the joint's."""
    with calm_robot(changes=changes), connected() as robot, streaming(robot) as stream:
        recorder = Recorder("arm")
        story(robot, stream)
        records = recorder.finish()
    assert recorder.lost == 0
    active = records["mode"] == Mode.active
    both = active[1:] & active[:-1]
    at_ns = records["release_ns"] + records["release_jitter_ns"]
    steps: npt.NDArray[np.float64] = np.abs(np.diff(records["setpoint_position_rad"][:, 0])) / (np.diff(at_ns) * 1e-9)
    told, joint = (np.abs(records[f"{kind}velocity_rad_s"][active, 0]).max() for kind in ("setpoint_", ""))
    return float(told), float(steps[both].max()), float(joint)


@pytest.mark.parametrize("story", [arm_far_away, stall])
def test_setpoint_and_joint_catch_up_with_a_stream_within_the_velocity_limit(
    story: Callable[[lithe.Robot, Stream], None], tell: Callable[[str], None]
) -> None:
    told, stepped, joint = speeds(SLOW, story)
    tell(f"limit {LIMIT_RAD_S} rad/s: setpoint {told:.3f}, from its angles {stepped:.3f}, joint {joint:.3f} rad/s")
    # Half of it shows that the limit was in the way: a busy machine may release too few ticks for all of it.
    assert 0.5 * LIMIT_RAD_S < told <= LIMIT_RAD_S + 1e-9, "it had far to go, and went as fast as it may"
    assert stepped <= 1.01 * LIMIT_RAD_S, "no jump that the told speed hides"
    assert joint <= JOINT_RAD_S


def test_the_checks_refuse_a_robot_that_rushes_to_its_stream(tell: Callable[[str], None]) -> None:
    told, stepped, joint = speeds(TWIN, arm_far_away)
    tell(f"twin: setpoint {told:.2f}, from its angles {stepped:.2f}, joint {joint:.2f} rad/s")
    assert told > LIMIT_RAD_S + 1e-9 and stepped > 1.01 * LIMIT_RAD_S and joint > JOINT_RAD_S
