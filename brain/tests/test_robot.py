# SPDX-License-Identifier: Apache-2.0
"""lithe.connect() against a real Spine: telemetry, plans, laws, parameters, verbs."""

import os
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path
from typing import Any

import lithe
import numpy as np
import pytest
from lithe._wire import PlanState
from lithe.errors import Refused
from system.robot_rig import ROOT, RobotRig

LAWS = ROOT / "laws"


def angle_of(robot: lithe.Robot) -> float:
    record = robot.telemetry.latest()
    assert record is not None
    return float(record["position_rad"][0])


def setpoint_of(robot: lithe.Robot) -> float:
    record = robot.telemetry.latest()
    assert record is not None
    return float(record["setpoint_position_rad"][0])


def follow(robot: lithe.Robot, angle_rad: float, near_rad: float = 0.05) -> None:
    """Goes there and stays there, however long it takes on a busy machine."""
    robot.go_to([angle_rad], in_s=0.7)
    seen: list[bool] = []

    def stays() -> bool:
        robot.beat()
        seen.append(abs(angle_of(robot) - angle_rad) < near_rad)
        return len(seen) > 20 and all(seen[-20:])

    RobotRig.wait_for(stays)


def test_connect_pins_the_brain_to_its_core(robot: lithe.Robot, rig: RobotRig) -> None:
    cores = os.sched_getaffinity(0)
    robot.close()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # numpy may have come before lithe in this process
            again = lithe.connect()
        info = again.spine.info
        if int(info["cpu_brain"]) != int(info["cpu_spine"]):
            assert os.sched_getaffinity(0) == {int(info["cpu_brain"])}
        again.close()
    finally:
        os.sched_setaffinity(0, cores)


def test_a_second_brain_is_refused_and_a_third_after_the_first_has_left(robot: lithe.Robot) -> None:
    cores = os.sched_getaffinity(0)
    with pytest.raises(lithe.ShmError, match="already has a Brain"):
        lithe.Robot("arm")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # numpy came before lithe in this process
        looker = lithe.Robot("arm", writes_plans=False)
    os.sched_setaffinity(0, cores)
    assert looker.status()["robot"] == "arm"
    with pytest.raises(lithe.LitheError, match="only looks"):
        looker.publish([time.monotonic_ns()], [0.0])
    looker.close()


def test_drain_gives_every_tick_once_and_in_order(robot: lithe.Robot) -> None:
    robot.telemetry.drain()
    time.sleep(0.3)
    first = robot.telemetry.drain()
    time.sleep(0.3)
    ticks = np.concatenate([first["tick"], robot.telemetry.drain()["tick"]]).astype(np.int64)
    assert len(ticks) > 50 and robot.telemetry.lost == 0
    assert np.array_equal(ticks, np.arange(ticks[0], ticks[0] + len(ticks)))


def test_history_reaches_back_and_repeats(robot: lithe.Robot) -> None:
    time.sleep(0.5)
    half = robot.telemetry.history(0.5)
    assert 0.3e9 < half["release_ns"][-1] - half["release_ns"][0] < 0.6e9
    assert len(robot.telemetry.history(0.5)) > 100
    assert len(robot.telemetry.history(0.0)) == 0


def test_since_gives_all_that_came_after_a_tick_and_counts_what_is_gone(robot: lithe.Robot) -> None:
    newest = robot.telemetry.latest()
    assert newest is not None
    time.sleep(0.2)
    records, lost = robot.telemetry.since(int(newest["tick"]))
    assert records["tick"][0] == newest["tick"] + 1 and lost == 0
    assert np.array_equal(np.diff(records["tick"].astype(np.int64)), np.ones(len(records) - 1))
    RobotRig.wait_for(lambda: int(robot.status()["tick"]) > 4096 + 100)
    records, lost = robot.telemetry.since(50)
    assert lost > 0 and 50 + lost + len(records) == int(records["tick"][-1])
    all_of_it, lost = robot.telemetry.since(-5)
    assert lost + len(all_of_it) == int(all_of_it["tick"][-1]), "ticks count from 1"


def test_since_gives_all_although_the_spine_goes_on_while_it_looks(
    robot: lithe.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    cursor = robot.telemetry._cursor
    latest = cursor.latest

    def on_a_busy_machine() -> Any:
        record = latest()
        time.sleep(0.05)
        return record

    newest = latest()
    assert newest is not None
    time.sleep(0.02)
    monkeypatch.setattr(cursor, "latest", on_a_busy_machine)
    records, lost = robot.telemetry.since(int(newest["tick"]))
    assert records["tick"][0] == newest["tick"] + 1 and lost == 0


def test_threads_may_publish_at_once_and_ids_tell_the_order(robot: lithe.Robot) -> None:
    ids: list[int] = []

    def publish() -> None:
        ids.extend(robot.go_to([0.0], in_s=1.0) for _ in range(50))

    threads = [threading.Thread(target=publish) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(ids)) == 200
    RobotRig.wait_for(lambda: int(robot.telemetry.history(0.1)["plan_id"][-1]) == max(ids))


def test_a_plan_moves_the_arm(robot: lithe.Robot) -> None:
    robot.swap(LAWS / "gravity_pd.cpp", params={"mgl_nm": 0.165})
    follow(robot, 0.6)
    follow(robot, 0.0)


def test_a_horizon_of_waypoints_is_tracked_and_then_coasts_to_a_hold(robot: lithe.Robot) -> None:
    now_ns = time.monotonic_ns()
    times_ns = now_ns + np.arange(1, 11, dtype=np.int64) * 300_000_000
    plan_id = robot.publish(times_ns, 0.3 * np.sin(np.linspace(0.1, 1.0, 10)))

    def is_in(state: PlanState) -> bool:
        record = robot.telemetry.latest()
        return record is not None and (int(record["plan_id"]), int(record["plan_state"])) == (plan_id, state)

    RobotRig.wait_for(lambda: is_in(PlanState.track))
    RobotRig.wait_for(lambda: is_in(PlanState.hold))


@pytest.mark.parametrize(
    ("times_s", "angles"),
    [([0.1, 0.05], [0.0, 0.1]), ([0.1, 0.2], [0.0, float("nan")]), ([0.1], [99.0]), ([3600.0], [0.0])],
    ids=["time goes backwards", "NaN", "beyond the limits", "too far ahead"],
)
def test_a_bad_plan_is_refused_and_the_old_one_kept(
    robot: lithe.Robot, times_s: list[float], angles: list[float]
) -> None:
    good = robot.go_to([0.2], in_s=1.0)
    RobotRig.wait_for(lambda: int(robot.telemetry.history(0.1)["plan_id"][-1]) == good)
    cursor = int(robot.events()["cursor"])
    robot.publish(time.monotonic_ns() + np.array(times_s) * 1e9, angles)
    kinds: list[str] = []
    until = time.monotonic() + 60
    while "plan_refused" not in kinds and time.monotonic() < until:
        time.sleep(0.02)
        news = robot.events(cursor)  # some at a time: on a busy machine late ticks come before it
        cursor = int(news["cursor"])
        kinds += [event["kind"] for event in news["events"]]
    assert "plan_refused" in kinds
    record = robot.telemetry.latest()
    assert record is not None and int(record["plan_id"]) == good


def test_every_plan_has_an_answer_of_its_own_however_many_are_refused(robot: lithe.Robot) -> None:
    """Refused ones within a second, among good ones, asked for in any order and after newer plans."""
    now_ns = time.monotonic_ns
    bad, good = [], []
    for _ in range(8):
        bad.append(robot.publish([now_ns() + 10**9], [[9.0]], streaming=False))
        with pytest.raises(Refused, match="position_limit at joint shoulder, waypoint 1: 9.000 rad"):
            robot.decided(bad[-1], wait_s=60)
        good.append(robot.go_to([0.1], in_s=5))
        assert robot.decided(good[-1], wait_s=60)
    for plan in reversed(bad):
        with pytest.raises(Refused) as refusal:
            robot.decided(plan)
        assert refusal.value.code == "refused_plan" and refusal.value.detail["reason"] == "position_limit"
        assert refusal.value.detail["value"] == 9.0 and refusal.value.detail["limit"] == 3.0
    degrees = robot.publish([now_ns() + 10**9], [[90.0]], streaming=False)
    with pytest.raises(Refused, match=r"angles are in radians: 90 degrees are 1\.571"):
        robot.decided(degrees, wait_s=60)
    assert [robot.decided(plan) for plan in reversed(good)] == [True] * 8
    assert robot.decided(degrees + 1) is False, "nobody published it"
    for verb, next_step in (("hold", "arm, then"), ("estop", "reset, then arm"), ("reset", "arm, then")):
        robot.call(verb)
        with pytest.raises(Refused) as refusal:
            robot.decided(robot.go_to([0.1], in_s=5), wait_s=60)
        assert refusal.value.code == "refused_mode" and next_step in refusal.value.next
    robot.arm()


@pytest.mark.parametrize(
    ("plan", "why", "next_step"),
    [
        (([-0.5], [0.1]), "too_old: waypoint 1 is 0.5", "plan ahead"),
        (([3600.0], [0.1]), "too_far: waypoint 1 is 3", "at most the next 10 s"),
        (([0.2, 0.1], [0.1, 0.1]), "time_order: waypoint 2 is 0.100 s before", "sort the waypoints"),
        (([1.0], [float("nan")]), "not_finite at joint shoulder, waypoint 1", "numpy.isfinite"),
        (([1.0], [[0.1, 0.1]]), "joints: the plan has 2, the robot 1", "robot.spine.joint_names"),
        (([1.0, 1.01], [0.0, 2.0]), "velocity_limit at joint shoulder, waypoint 2: 200.000", "at least 0.11 s"),
        (([1.0, 1.01], [-3.0, 3.0]), "velocity_limit at joint shoulder, waypoint 2: 600.000", "numpy.unwrap"),
        (([0.02], [2.9]), "velocity_limit at joint shoulder, waypoint 1", "at least 0."),
    ],
    ids=lambda each: each.split()[0].strip(":") if isinstance(each, str) else "",
)
def test_each_reason_to_refuse_a_plan_has_its_own_next_step(
    robot: lithe.Robot, plan: tuple[list[float], Any], why: str, next_step: str
) -> None:
    robot.go_to([0.0], in_s=0.5)
    RobotRig.wait_for(lambda: abs(setpoint_of(robot)) < 1e-3)
    times_s, angles = plan
    with pytest.raises(Refused) as refusal:
        robot.decided(robot.publish(time.monotonic_ns() + np.array(times_s) * 1e9, angles, streaming=False), wait_s=60)
    assert why in refusal.value.message and next_step in refusal.value.next, refusal.value


@pytest.mark.parametrize("ahead_s", [86400, -60])
def test_a_brain_with_another_clock_is_told_so(robot: lithe.Robot, rig: RobotRig, ahead_s: int) -> None:
    """Its own time namespace: plans are refused, never taken for followed, and it and `status` say why."""
    unshare = ["unshare", "-Ur", "-T", "--monotonic", str(ahead_s), "--fork"]
    if subprocess.run([*unshare, "true"], capture_output=True, check=False).returncode != 0:
        pytest.skip("no right to make a time namespace")
    robot.close()
    script = """if True:
        import lithe
        robot = lithe.connect()
        try:
            print("decided", robot.decided(robot.go_to([0.1], in_s=0.5), wait_s=60))
        except lithe.Refused as refused:
            print(refused)
        input()
    """
    env = os.environ | {"PYTHONPATH": str(Path(lithe.__file__).parents[1])}
    command = [*unshare, sys.executable, "-c", script]
    with subprocess.Popen(command, env=env, stdin=-1, stdout=-1, stderr=-1, text=True) as brain:
        assert brain.stdout is not None and brain.stderr is not None
        said = brain.stdout.readline() + brain.stdout.readline()
        status = rig.lithe("status").stdout
        warned = brain.communicate("\n", timeout=60)[1]
    assert ("too_old" if ahead_s < 0 else "too_far") in said and "decided" not in said, said
    assert f"{abs(ahead_s)}.0 s {'ahead of' if ahead_s > 0 else 'behind'} the Spine's" in said, said
    assert "time namespace" in warned, warned
    assert "never seen" not in status and ("time namespace" in status) == (ahead_s > 0), status


@pytest.mark.parametrize(
    ("times", "angles", "words"),
    [([], [], "1 to 16 waypoints"), (range(17), range(17), "1 to 16 waypoints"), ([1, 2], [0.0], "times")],
)
def test_a_plan_of_the_wrong_shape_never_leaves_the_brain(
    robot: lithe.Robot, times: list[int], angles: list[float], words: str
) -> None:
    with pytest.raises(lithe.LitheError, match=words):
        robot.publish(np.array(list(times), dtype=np.int64), np.array(list(angles), dtype=float))


def test_swap_takes_text_or_file_and_tells_what_happened(robot: lithe.Robot) -> None:
    record = robot.swap((LAWS / "hold.cpp").read_text(), name="held.cpp")
    assert record["law"] == "hold" and record["commit_tick"] > 0
    assert robot.status()["law"] == "hold"
    assert robot.swap(str(LAWS / "pd.cpp"))["law"] == "pd"
    robot.rollback()
    assert robot.status()["law"] == "hold"


def test_a_law_that_does_not_compile_is_refused_with_its_line(robot: lithe.Robot) -> None:
    before = robot.status()["law_id"]
    with pytest.raises(lithe.Refused) as caught:
        robot.swap('#include <lithe/law.hpp>\nstruct X { int y = "no"; };\n', name="x.cpp")
    assert "2" in str(caught.value.detail) and "x.cpp" in str(caught.value.detail)
    assert robot.status()["law_id"] == before


def test_a_missing_law_file_is_one_of_our_errors(robot: lithe.Robot, tmp_path: Path) -> None:
    with pytest.raises(lithe.LitheError, match=r"none\.cpp"):
        robot.swap(tmp_path / "none.cpp")


def test_parameters_are_read_set_and_kept_in_range(robot: lithe.Robot) -> None:
    robot.swap(LAWS / "pd.cpp")
    robot.params["kp_nm_rad"] = 3.0
    assert robot.params["kp_nm_rad"] == 3.0
    robot.params.set(kp_nm_rad=4.0, kd_nm_s_rad=0.2)
    assert robot.params["kd_nm_s_rad"] == 0.2
    with pytest.raises(lithe.Refused):
        robot.params["kp_nm_rad"] = -1.0
    with pytest.raises(lithe.Refused):
        robot.params["no_such_thing"] = 1.0
    with pytest.raises(lithe.LitheError, match="kp_nm_rad"):
        robot.params["kp"]
    assert robot.params["kp_nm_rad"] == 4.0


def test_the_verbs_change_the_mode(robot: lithe.Robot) -> None:
    robot.hold()
    assert robot.status()["mode"] == "hold"
    robot.disarm()
    assert robot.status()["mode"] == "disarmed"
    robot.arm()
    assert robot.status()["mode"] == "active"


def test_estop_acts_through_shared_memory_and_reset_lifts_it(robot: lithe.Robot) -> None:
    assert robot.estop()["mode"] == "estop"
    with pytest.raises(lithe.Refused) as caught:
        robot.arm()
    assert caught.value.code == "refused_estop"
    robot.reset()
    assert robot.status()["mode"] == "disarmed"
    robot.arm()


def test_an_unknown_robot_is_named(rig: RobotRig) -> None:
    with pytest.raises(lithe.NotRunning, match="leg"):
        lithe.connect("leg")
