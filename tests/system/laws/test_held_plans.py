# SPDX-License-Identifier: Apache-2.0
"""A policy's targets as the setpoint (interpolation "hold"), on a running robot: by the package and the gateway."""

import math
import time
from collections.abc import Callable, Iterator

import lithe
import numpy as np
import pytest
from calm import calm_robot, connected
from lithe._wire import PlanState
from lithe.errors import BadPlan, Refused
from lithe.gateway import Gateway
from lithe.remote import Remote
from system.robot_rig import ROOT

PERIOD_S = 0.02


@pytest.fixture
def robot() -> Iterator[lithe.Robot]:
    """The arm, with a record that is empty from now on."""
    with calm_robot() as _, connected() as robot:
        robot.telemetry.drain()
        yield robot


def run_policy(robot: lithe.Robot, seconds: float, at: Callable[[float], None] = lambda _: None) -> dict[int, tuple]:
    """A policy at 50 Hz: a target from the newest state, held from now on; plan id -> time and target."""
    published = {}
    began_s = next_s = time.monotonic()
    while (now_s := time.monotonic()) < began_s + seconds:
        record = robot.telemetry.latest()
        assert record is not None
        target_rad = 0.4 * math.sin(3 * (now_s - began_s)) + 0.01 * float(record["position_rad"][0])
        t_ns = time.monotonic_ns()
        published[robot.publish([t_ns], [target_rad], interpolation="hold")] = (t_ns, target_rad)
        at(now_s - began_s)
        next_s = max(next_s + PERIOD_S, time.monotonic())
        time.sleep(max(0.0, next_s - time.monotonic()))
    return published


def test_every_tick_has_the_newest_target_of_a_policy(robot: lithe.Robot) -> None:
    """To the bit: in the tick that takes a plan, its target is the setpoint, and it stays until the next one."""
    published = run_policy(robot, 4)
    records = robot.telemetry.drain()
    ours = records[np.isin(records["plan_id"], list(published))]
    assert len(ours) > 1000, "ticks that followed the policy"
    followed = {int(each) for each in ours["plan_id"]}
    assert len(followed) > 40, f"{len(followed)} of {len(published)} plans reached a tick"
    for plan_id in followed:
        t_ns, target_rad = published[plan_id]
        held = ours[ours["plan_id"] == plan_id]
        assert set(held["setpoint_position_rad"][:, 0]) == {target_rad}
        assert set(held["setpoint_velocity_rad_s"][:, 0]) == {0.0}
        woke_ns = held["release_ns"] + held["release_jitter_ns"]
        assert (held["setpoint_age_ns"] == woke_ns - t_ns).all()
        fresh = held["setpoint_age_ns"] < 2_000_000_000
        assert ((held["plan_state"] == PlanState.track) == fresh).all()
    moved_rad = np.ptp(ours["position_rad"][:, 0])
    assert moved_rad > 0.4, f"the joint followed: {moved_rad:.2f} rad of 0.8"


def test_a_policy_that_ends_leaves_its_last_target_and_its_age(robot: lithe.Robot) -> None:
    """From stale_after_s on status says so, although the Brain's heartbeat goes on; a curve then leaves from there."""
    robot.decided(robot.publish([time.monotonic_ns()], [0.25], [[1.0]], interpolation="hold"), wait_s=60)
    assert robot.status()["plan"] == "track"
    end_s = time.monotonic() + 20
    while (status := robot.status())["plan"] != "hold":
        assert status["setpoint_age_ms"] < 2500 + 1e3 * (time.monotonic() - end_s + 20)
        assert time.monotonic() < end_s
        time.sleep(0.05)
    assert status["setpoint_age_ms"] >= 2000
    assert status["mode"] == "active"
    record = robot.telemetry.latest()
    assert record is not None
    assert (record["setpoint_position_rad"][0], record["setpoint_velocity_rad_s"][0]) == (0.25, 0)
    robot.telemetry.drain()
    plan_id = robot.go_to([0.0], in_s=1)
    assert robot.decided(plan_id, wait_s=60)
    time.sleep(0.3)
    curve = robot.telemetry.drain()
    curve = curve[curve["plan_id"] == plan_id]
    assert abs(curve["setpoint_position_rad"][0, 0] - 0.25) < 0.01
    assert (curve["setpoint_age_ns"] == -1).all()


def test_what_no_joint_may_do_is_refused_and_the_target_before_stays(robot: lithe.Robot) -> None:
    """Outside the limits, or too old; the size of a step is no reason. Another word than cubic or hold: BadPlan."""
    robot.decided(robot.publish([time.monotonic_ns()], [0.1], interpolation="hold"), wait_s=60)
    with pytest.raises(Refused, match=r"position_limit at joint shoulder, waypoint 2: 3\.500 rad, allowed") as beyond:
        now_ns = time.monotonic_ns()
        robot.decided(robot.publish([now_ns, now_ns + 10**8], [0.0, 3.5], interpolation="hold"), wait_s=60)
    assert beyond.value.code == "refused_plan"
    with pytest.raises(
        Refused, match=r"too_old: waypoint 1 is 3\.\d+ s behind the Spine's clock, allowed 2\.000"
    ) as old:
        robot.decided(robot.publish([time.monotonic_ns() - 3 * 10**9], [0.0], interpolation="hold"), wait_s=60)
    assert "stale_after_s" in old.value.next
    with pytest.raises(BadPlan, match="interpolation is cubic or hold, not 'linear'"):
        robot.publish([time.monotonic_ns()], [0.0], interpolation="linear")
    record = robot.telemetry.latest()
    assert record is not None
    assert record["setpoint_position_rad"][0] == 0.1


def test_a_good_law_is_confirmed_under_a_policy(robot: lithe.Robot) -> None:
    """Curve before, steps on probation: they are the plan's, not the law's. Through the gateway, too."""
    robot.go_to([0.2], in_s=1)
    time.sleep(1.2)
    robot.swap(ROOT / "laws/gravity_pd.cpp", params={"mgl_nm": 0.165}, probation_s=1)
    run_policy(robot, 4)
    end_s = time.monotonic() + 30
    while (verdict := robot.status()["last_swap"]["verdict"]) in ("committed", "unproven"):
        assert time.monotonic() < end_s, verdict
        run_policy(robot, 1)
    assert verdict == "confirmed", robot.status()["last_swap"]
    assert robot.status()["law_suspected"] is None
    gateway = Gateway(robot, token="sesame")
    gateway.start()
    with Remote("127.0.0.1", gateway.port, "sesame") as agent:
        now_ns = agent.call("describe")["now_ns"]
        told = agent.call("publish", t_ns=[now_ns], position_rad=[[0.3]], interpolation="hold")
        assert told["accepted"] in (True, None)
        with pytest.raises(Refused, match="interpolation"):
            agent.call("publish", t_ns=[now_ns], position_rad=[[0.3]], interpolation="linear")
    gateway.close()
