# SPDX-License-Identifier: Apache-2.0
"""A Brain that outlives its robot's supervisor, or its robot: what goes on by itself, and what asks first."""

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import calm
import lithe
import numpy as np
import pytest
from lithe.control import connect_control
from system.robot_rig import RobotRig


@pytest.fixture(scope="module")
def rig() -> Iterator[RobotRig]:
    """A robot of its own: here it is killed and started anew."""
    with calm.calm_robot() as running:
        yield running


@pytest.fixture
def brain(rig: RobotRig) -> Iterator[lithe.Robot]:
    with calm.connected() as robot:
        yield robot


def run_again(rig: RobotRig) -> None:
    rig.run()
    rig.wait_for(lambda: rig.ask("status")["mode"] == "active")


def setpoint_rad(robot: lithe.Robot) -> float:
    record = robot.telemetry.latest()
    assert record is not None
    return float(record["setpoint_position_rad"][0])


def test_verbs_find_a_new_supervisor_and_plans_never_needed_one(rig: RobotRig, brain: lithe.Robot) -> None:
    assert brain.status()["adopted"] is False
    rig.started[-1].kill()
    rig.started[-1].wait()
    with pytest.raises(lithe.NotRunning, match=r"'arm' has no supervisor[\s\S]*lithe run ROBOT.toml adopts it"):
        brain.status()
    with pytest.raises(lithe.NotRunning, match=r"'arm' has no supervisor[\s\S]*takes it over"):
        connect_control("arm")
    brain.go_to([0.3], in_s=0.3)
    rig.wait_for(lambda: abs(setpoint_rad(brain) - 0.3) < 1e-3)
    rig.socket.unlink()
    run_again(rig)
    assert brain.status()["adopted"] is True
    assert brain.attached


def test_a_robot_started_anew_is_told_apart_from_the_one_before(rig: RobotRig, brain: lithe.Robot) -> None:
    brain.telemetry.drain()
    rig.wait_for(lambda: int(brain.status()["tick"]) > 1000)
    last = brain.telemetry.latest()
    assert last is not None
    brain.call("shutdown")
    rig.started[-1].wait(60)

    assert not brain.attached
    left = brain.telemetry.drain()
    assert len(left) > 0 and left["tick"][-1] >= last["tick"]
    for ask in (brain.telemetry.drain, brain.telemetry.latest, lambda: brain.telemetry.history(1.0)):
        with pytest.raises(lithe.NotRunning, match=r"robot\.reconnect\(\)"):
            ask()
    with pytest.raises(lithe.NotRunning, match=r"robot\.reconnect\(\)"):
        brain.go_to([0.0], in_s=1.0)
    with pytest.raises(lithe.LitheError, match="is not running"):
        brain.reconnect()
    brain.beat()  # a heartbeat into the void harms nobody

    run_again(rig)
    with pytest.raises(lithe.NotRunning, match=r"robot\.reconnect\(\)"):
        brain.go_to([0.0], in_s=1.0)
    assert brain.status()["mode"] == "active", "verbs need no reconnect()"
    brain.reconnect()
    brain.reconnect()
    plan = brain.go_to([0.2], in_s=0.3)
    rig.wait_for(lambda: abs(setpoint_rad(brain) - 0.2) < 1e-3)
    records, lost = brain.telemetry.since(int(last["tick"]) + 10**9)
    assert records["tick"][-1] < 10**9 and lost >= 0
    assert plan in records["plan_id"]
    with pytest.raises(lithe.ShmError, match="already has a Brain"):
        lithe.Robot("arm")
    time.sleep(2.5)  # longer than the calm robot waits for a sign of life

    def beats() -> bool:
        newest = brain.telemetry.latest()
        return newest is not None and 0 <= int(newest["brain_age_ns"]) < 2e9

    rig.wait_for(beats)  # the heartbeat came along: only a new one makes the age less


def test_an_estop_stops_the_robot_that_runs_now(rig: RobotRig, brain: lithe.Robot) -> None:
    brain.call("shutdown")
    rig.started[-1].wait(60)
    run_again(rig)
    assert not brain.attached
    assert brain.estop(within_s=10)["mode"] == "estop"
    assert brain.status()["mode"] == "estop"
    assert brain.reset()["mode"] == "disarmed"


def test_a_place_taken_by_another_brain_is_not_taken_back(rig: RobotRig, brain: lithe.Robot) -> None:
    brain.call("shutdown")
    rig.started[-1].wait(60)
    run_again(rig)
    brain._leave_the_brain()  # as when this process had been suspended through it all, and lost its lease
    with calm.connected() as other:
        with pytest.raises(lithe.ShmError, match="already has a Brain"):
            brain.reconnect()
        assert not brain.attached, "it may try again"
        other.go_to([0.0], in_s=0.5)
    brain.reconnect()
    assert brain.attached and np.isfinite(setpoint_rad(brain))


def test_the_gateways_own_process_goes_on_with_the_new_robot(rig: RobotRig) -> None:
    token_file = rig.dir / "token"
    command = [
        sys.executable,
        "-m",
        "lithe.gateway",
        "--port",
        "0",
        "--tier",
        "person",
        "--token-file",
        str(token_file),
    ]
    env = rig.env | {"PYTHONPATH": str(Path(lithe.__file__).parents[1])}
    with subprocess.Popen(command, stdout=-1, env=env, text=True) as gateway:
        try:
            assert gateway.stdout is not None
            said = gateway.stdout.readline()
            assert said.startswith("robot arm at 127.0.0.1:") and said.endswith(f"token in {token_file}\n")
            port = int(said.split(",")[0].rsplit(":", 1)[1])
            with lithe.Remote("127.0.0.1", port, token_file) as remote:
                assert remote.call("describe")["robot"] == "arm"
                remote.call("shutdown")
                rig.started[-1].wait(60)
                with pytest.raises(lithe.Refused) as caught:
                    remote.call("describe")
                assert caught.value.code == "disconnected"
                with pytest.raises(lithe.Refused) as caught:
                    remote.call("status")
                assert caught.value.code == "disconnected"
                run_again(rig)

                def plan_taken() -> bool:
                    try:
                        remote.call("publish", t_ns=[time.monotonic_ns() + 10**9], position_rad=[0.1])
                    except lithe.Refused as refused:
                        assert refused.code == "disconnected", refused
                        return False
                    return True

                rig.wait_for(plan_taken)
                time.sleep(2.5)  # longer than the calm robot waits for a sign of life
                rig.wait_for(lambda: 0 <= remote.call("latest", fields=["brain_age_ns"])["brain_age_ns"] < 2e9)
        finally:
            gateway.send_signal(signal.SIGINT)
            assert gateway.wait(30) == 0
