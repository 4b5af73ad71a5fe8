# SPDX-License-Identifier: Apache-2.0
"""A Brain whose supervisor was killed: the verbs go through its mailbox in shared memory, and answers say so."""

import fcntl
import logging
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import calm
import lithe
import numpy as np
import pytest
from lithe import mailbox
from lithe._wire import CommandKind, CommandResult, Mode
from segments import Writer, own_prefix, remove
from system.robot_rig import ROOT, RobotRig

LAWS = ROOT / "laws"


@pytest.fixture(scope="module")
def rig() -> Iterator[RobotRig]:
    """A robot with two laws, whose supervisor is gone; what it left in shared memory is all there is."""
    with calm.calm_robot() as running:
        with calm.connected() as robot:
            robot.swap(LAWS / "gravity_pd.cpp", params={"mgl_nm": 0.165}, probation_s=0)
            robot.swap(LAWS / "hold.cpp", probation_s=0)
            untried(robot)
            running.started[-1].send_signal(signal.SIGSTOP)
            time.sleep(2.5)  # silent, but alive
            untried(robot)
        running.started[-1].kill()
        running.started[-1].wait()
        yield running


def untried(robot: lithe.Robot) -> None:
    """While the supervisor lives, only its verb sets parameters: it tries them."""
    live = robot.spine.params()
    assert live is not None
    letter = np.zeros((), lithe.shm.dtype("Command"))
    letter["kind"], letter["count"], letter["value"][0] = CommandKind.set_params, 1, live["value"][0]
    ticket = robot._check().send(letter, robot.spine)
    RobotRig.wait_for(lambda: robot.spine.answer(ticket) != 0)
    assert robot.spine.answer(ticket) == CommandResult.refused_untried


@pytest.fixture
def robot(rig: RobotRig) -> Iterator[lithe.Robot]:
    with calm.connected() as robot:  # without a name: it is found by its Spine
        if mode(robot) != Mode.active:
            robot.arm()
        yield robot


def mode(robot: lithe.Robot) -> Mode:
    record = robot.telemetry.latest()
    assert record is not None
    return Mode(int(record["mode"]))


def law(robot: lithe.Robot) -> str:
    running = robot.spine.running_law()
    assert running is not None
    return str(running["name"].item().decode())


def test_the_modes_change_and_the_answer_says_how(robot: lithe.Robot, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "lithe"):
        answer = robot.hold()
    assert (answer["mode"], answer["via"]) == ("hold", "mailbox")
    assert mode(robot) == Mode.hold
    assert "no supervisor of 'arm' lives: 'hold' goes through shared memory" in caplog.text
    assert robot.disarm()["mode"] == "disarmed"
    assert robot.arm()["mode"] == "active", "drives that were switched off a moment ago are waited for"
    assert int(robot.arm()["tick"]) > int(answer["tick"])


def test_a_rollback_brings_back_the_law_before(robot: lithe.Robot) -> None:
    assert law(robot) == "hold"
    answer = robot.rollback()
    assert (answer["law"], answer["via"]) == ("gravity_pd", "mailbox")
    assert law(robot) == "gravity_pd"
    with pytest.raises(lithe.Refused) as caught:
        robot.rollback(steps=4)
    assert caught.value.code == "refused_law"
    with pytest.raises(lithe.Refused, match="1 to 4"):
        robot.rollback(steps=0)


def test_parameters_are_read_set_and_kept_in_range(robot: lithe.Robot) -> None:
    name = next(iter(robot.params.get()))
    before = robot.params.get()[name]
    wanted = (before["value"] + before["min"]) / 2
    answer = robot.params.set(**{name: wanted})
    assert answer["via"] == "mailbox"
    assert robot.params[name] == wanted
    robot.params.revert()
    assert robot.params[name] == before["value"]
    with pytest.raises(lithe.Refused) as caught:
        robot.params[name] = np.nextafter(before["max"], np.inf)
    assert caught.value.code == "refused_range"
    with pytest.raises(lithe.Refused) as caught:
        robot.params.set(no_such_thing=1.0)
    assert caught.value.code == "unknown_param"
    for arguments in ({"values": {}}, {"values": [1.0]}, {}):
        with pytest.raises(lithe.Refused) as caught:
            robot.call("set_params", **arguments)
        assert caught.value.code == "usage"
    for wrong in (float("nan"), "4.0", True, None):
        with pytest.raises(lithe.Refused) as caught:
            robot.call("set_params", name=name, value=wrong)
        assert caught.value.code == "refused_range"
    assert robot.params[name] == before["value"]


def test_the_way_back_from_an_estop_needs_no_supervisor(robot: lithe.Robot) -> None:
    robot.estop()
    with pytest.raises(lithe.Refused, match=r"cannot arm in mode estop") as caught:
        robot.arm()
    assert caught.value.code == "refused_estop"
    assert robot.reset()["mode"] == "disarmed"
    with pytest.raises(lithe.Refused) as caught:
        robot.hold()
    assert caught.value.code == "refused_mode"
    assert robot.arm()["mode"] == "active"


def test_more_letters_than_the_mailbox_holds_are_all_answered(robot: lithe.Robot) -> None:
    for _ in range(20):
        assert robot.hold()["mode"] == "hold"
        assert robot.arm()["mode"] == "active"


def test_a_verb_that_needs_a_supervisor_says_which_do_not(robot: lithe.Robot) -> None:
    with pytest.raises(lithe.NotRunning, match=r"'swap' needs one[\s\S]*lithe run[\s\S]*arm, disarm, hold"):
        robot.swap(LAWS / "pd.cpp")
    assert law(robot) in ("hold", "gravity_pd")


def test_a_connection_that_only_looks_reads_and_sends_nothing(robot: lithe.Robot) -> None:
    robot.close()
    looker = lithe.Robot("arm", writes_plans=False)
    try:
        assert looker.params.get()
        with pytest.raises(lithe.LitheError, match="only looks"):
            looker.hold()
        assert mode(looker) == Mode.active
    finally:
        looker.close()


def test_a_supervisor_that_lives_elsewhere_is_not_passed_by(
    rig: RobotRig, robot: lithe.Robot, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    rig.socket.unlink()  # a killed supervisor leaves its file
    rig.run()
    assert "via" not in robot.hold(), "the supervisor that adopted the Spine answers"
    assert "via" not in robot.arm()
    monkeypatch.setenv("LITHE_RUN_DIR", str(tmp_path))
    robot._control.close()
    monkeypatch.setattr(robot, "_control", lithe.control.connect_control("arm", may_be_absent=True))
    with pytest.raises(lithe.NotRunning, match=r"its supervisor lives[\s\S]*LITHE_RUN_DIR"):
        robot.hold()
    assert mode(robot) == Mode.active
    assert not mailbox.ticks_alone("arm")


# ---- which robots tick alone, told by segments without a Spine


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    monkeypatch.setenv("LITHE_SHM_PREFIX", own_prefix())
    monkeypatch.setenv("LITHE_RUN_DIR", str(tmp_path))
    yield
    for name in ("arm", "leg"):
        remove(name)


def spine(name: str) -> Writer:
    writer = Writer(name, "spine")
    writer.channel("robot_info", joint_count=1, rate_hz=1000.0, robot=name)
    return writer


def test_a_spine_that_ticks_without_a_supervisor_is_found(alone: None) -> None:
    assert mailbox.robots_alone() == []
    with pytest.raises(lithe.NotRunning, match="no robot runs here"):
        lithe.connect()
    arm = spine("arm")
    assert mailbox.robots_alone() == ["arm"]
    spine("leg")
    with pytest.raises(lithe.LitheError, match="several robots tick here without a supervisor: arm, leg"):
        lithe.connect()
    lithe.shm.shim().lithe_store(arm.mapping.base + lithe._wire.SegmentHeader.heartbeat_ns.offset, 1)
    assert mailbox.robots_alone() == ["leg"], "the other one ticks no more"


def test_a_robot_whose_supervisor_holds_its_lease_is_not_alone(alone: None) -> None:
    spine("arm")
    with open(f"{lithe.shm.shm_path('arm', 'control')}.lock", "w", encoding="utf-8") as lock:
        assert mailbox.ticks_alone("arm"), "a lock file outlives its holder"
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert mailbox.supervisor_lives("arm")
        assert mailbox.robots_alone() == []


def test_a_file_of_somebody_else_is_not_taken_for_a_robot(alone: None, monkeypatch: pytest.MonkeyPatch) -> None:
    spine("arm")
    monkeypatch.setattr(mailbox.os, "geteuid", lambda: 12345)
    assert mailbox.robots_alone() == []
