# SPDX-License-Identifier: Apache-2.0
"""Robots beside the desk arm: over a serial adapter, of two kinds of drive, with twelve joints."""

import contextlib
import json
import math
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import calm
import lithe
import numpy as np
import numpy.typing as npt
import pytest
from lithe.demo import losses
from lithe.demo.recorder import Recorder
from system.robot_rig import ROOT
from system.simulated import Simulated, at_terminals, running

pytestmark = pytest.mark.early

SWAPS, STALLED_SWAPS = 40, 12
BEFORE_NS, AFTER_NS = 5_000_000, 6_000_000
STALL_S = 0.003
SURE = 1e-4


@pytest.fixture(autouse=True)
def no_other_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test sets is undone after it."""
    for key in ("LITHE_RUN_DIR", "LITHE_SHM_PREFIX", "LITHE_OUT_DIR"):
        monkeypatch.delenv(key, raising=False)


def demo(robot: Path, out: Path, *words: str) -> dict[str, Any]:
    """The summary of a whole experiment."""
    done = subprocess.run(
        [sys.executable, "-m", "lithe.demo", "--robot", robot, "--out", out, *words],
        check=False, capture_output=True, text=True, timeout=400, cwd=ROOT,
    )  # fmt: skip
    assert (out / "summary.json").exists(), done.stdout + done.stderr
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text())
    assert calm.falls_short(summary) == [], done.stdout
    return summary


@pytest.mark.long
def test_the_demo_runs_unchanged_over_an_fdcanusb(tmp_path: Path, tell: Callable[[str], None]) -> None:
    """The simulated drive is in another process, at the far end of a serial device."""
    with Simulated(ROOT / "robots/arm.toml", tmp_path / "buses") as sim:
        changes = {
            'kind = "loop" ': f'kind = "fdcanusb"\npath = "{sim.path()}" ',
            "lost_after_misses = 3 ": "lost_after_misses = 2000 ",
        }
        robot = tmp_path / "usb.toml"
        robot.write_text(calm.calm_text(changes, ideal=False), encoding="utf-8")
        summary = demo(robot, tmp_path / "out", "--over-real-buses")
    lost = f"{summary['lost_ticks']} of {summary['ticks']} ticks lost"
    tell(f"RMSE of the last law {summary['phases'][-1]['rmse_deg']:.2f} deg, {lost}")


@pytest.mark.long
def test_the_demo_runs_unchanged_on_two_kinds_of_drive(tmp_path: Path, tell: Callable[[str], None]) -> None:
    """Seven joints at once: five bear gravity, and the agent finds out which, and how heavy each is."""
    robot = tmp_path / "frankenstein.toml"
    robot.write_text(calm.calm_text(robot="frankenstein"), encoding="utf-8")
    summary = demo(robot, tmp_path / "out")
    joints = {joint["name"]: joint for joint in summary["joints"]}
    weightless = {name for name, joint in joints.items() if joint["mgl_hat_nm"] == 0}
    assert (len(joints), weightless) == (7, {"column", "hand"})
    assert len({round(joint["mgl_true_nm"], 3) for joint in joints.values()}) > 3, "they differ, and so do the rows"
    law = (tmp_path / "out/evolved.cpp").read_text(encoding="utf-8")
    for name, joint in joints.items():
        assert f"{{{joint['mgl_hat_nm']:.8g}, {joint['estimate']['inertia_hat_kg_m2']:.8g}, " in law and name in law
    for joint in joints.values():
        tell(
            f"{joint['name']}: mgl off by {joint['mgl_error']:.1%}, RMSE {joint['rmse_deg']['baseline']:.1f} -> "
            f"{joint['rmse_deg']['evolved']:.2f} deg at {joint['estimate']['bandwidth_rad_s']:.0f} rad/s"
        )


MOUNTED_THE_OTHER_WAY_ROUND = {
    "position_min_rad = -2.5\nposition_max_rad = 2.5": "sign = -1\nposition_min_rad = -2.2\nposition_max_rad = 0.3",
    "position_min_rad = -0.2\nposition_max_rad = 2.4": "position_min_rad = -2.4\nposition_max_rad = 0.2",
    "position_min_rad = -0.1\nposition_max_rad = 1.2": "position_min_rad = -1.2\nposition_max_rad = 0.1",
    "position_min_rad = -1.5\nposition_max_rad = 1.5": "position_min_rad = -1.5\nposition_max_rad = 0.6",
    'device = "upper_arm_drive"\nsign = -1': 'device = "upper_arm_drive"\nsign = 1',
}


@pytest.mark.long
def test_the_demo_holds_on_a_robot_mounted_the_other_way_round(tmp_path: Path, tell: Callable[[str], None]) -> None:
    """As a left leg is: where a joint has one heavy place only, that is on the negative side."""
    robot = tmp_path / "mirrored.toml"
    robot.write_text(calm.calm_text(MOUNTED_THE_OTHER_WAY_ROUND, robot="frankenstein"), encoding="utf-8")
    summary = demo(robot, tmp_path / "out")
    heavy = [joint for joint in summary["joints"] if joint["bears_gravity"]]
    assert len(heavy) == 5 and all(joint["freeze"]["rest_angle_deg"] < -60 for joint in heavy)
    for joint in heavy:
        share, error_deg = joint["freeze"]["gravity_share"], joint["rmse_deg"]["evolved"]
        tell(f"{joint['name']}: at {joint['freeze']['rest_angle_deg']:.0f} deg {share:.0%}, RMSE {error_deg:.2f} deg")


# Of robots/chain.toml: mass, way to the centre, length, inertia; the last one is a thin rod.
LINKS = [(0.35, 0.16, 0.25, 2.5e-3), (0.25, 0.13, 0.2, 1.2e-3), (0.08, 0.06, 0.12, 0.08 * 0.12**2 / 12)]


def as_model(text: str, path: Path) -> str:
    """The chain's robot file on an MJCF model of the same chain, which goes to that path."""
    opened, above = "", 0.0
    for name, (mass, centre, length, inertia) in zip(("shoulder", "elbow", "wrist"), LINKS, strict=True):
        opened += f"<body pos='0 {-above} 0'><joint name='{name}' axis='0 0 1' armature='2e-3' damping='2e-2' "
        opened += f"frictionloss='0.03'/><inertial pos='0 {-centre} 0' mass='{mass}' "
        opened += f"diaginertia='{inertia} {inertia} {inertia}'/>"
        above = length
    world = f"<worldbody>{opened}{'</body>' * len(LINKS)}</worldbody>"
    path.write_text(f"<mujoco><option gravity='0 -9.81 0'/>{world}</mujoco>", encoding="utf-8")
    text = re.sub(r"(?ms)^\[(defaults\.)?joint\.sim\].*?(?=^\[|\Z)", "", text)
    text = re.sub(r"(?m)^gravity_m_s2 = 9\.81.*\n", "", text)  # of [plant]; [model] keeps its own
    return text.replace('kind = "chain" ', f'kind = "mujoco"\nmodel = "{path}" ', 1)


@pytest.mark.parametrize("plant", ["chain", "mujoco"])
def test_joints_that_hang_on_each_other_run_and_swap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tell: Callable[[str], None], plant: str
) -> None:
    """The shoulder alone is sent away, and carries the links that hang on it, also under another law."""
    text = calm.calm_text(robot="chain")
    text = as_model(text, tmp_path / "chain.xml") if plant == "mujoco" else text
    with running(text, monkeypatch, excuse="apt-get install libmujoco-dev") as (_, robot):
        at_rest = robot.telemetry.latest()["command_torque_nm"][0]
        robot.go_to([1.2, 0.0, 0.0], in_s=1.5)
        robot.swap((ROOT / "laws/gravity_pd.cpp").read_text(), name="gravity_pd.cpp", error_ratio=0)
        time.sleep(3.0)
        record = robot.telemetry.latest()
        status = robot.status()
    assert (status["mode"], status["law"]) == ("active", "gravity_pd")
    position, torque = record["position_rad"][:3], record["command_torque_nm"][:3]
    reach, load_nm = 0.0, 0.0
    for (mass, centre, length, _), angle in zip(LINKS, np.cumsum(position), strict=True):
        load_nm += 9.81 * mass * (reach + centre * np.sin(angle))
        reach += length * np.sin(angle)
    tell(f"at {np.round(position, 2)} rad the shoulder gives {torque[0]:.2f} Nm, {load_nm:.2f} Nm hang on it")
    assert position[0] > 0.4 and abs(at_rest) < 0.2
    assert abs(torque[0] - load_nm) < 0.15


def all_of_it_moves(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frankenstein's joints follow one plan under one law; a swap takes all of it along."""
    with running(text, monkeypatch) as (_, robot):
        joints = robot.spine.joint_count
        robot.go_to([0.3] * joints, in_s=2.0)
        robot.swap((ROOT / "laws/gravity_pd.cpp").read_text(), name="gravity_pd.cpp", error_ratio=0)
        time.sleep(2.5)
        record = robot.telemetry.latest()
        status = robot.status()
    assert (status["mode"], status["law"]) == ("active", "gravity_pd"), status
    moved = record["position_rad"][:joints]
    assert joints == 7
    # What stiffness 4 leaves of weight and friction is less than a sixth of a radian; of a wrong scale it is more.
    assert (np.abs(moved - 0.3) < 0.15).all(), moved
    assert set(status["sensors"]) == {"grip_n", "palm_touch", "boom_stop"}
    assert status["sensors"]["grip_n"] is not None and math.isfinite(status["sensors"]["grip_n"])
    assert {status["sensors"][name] for name in ("palm_touch", "boom_stop")} <= {0, 1}, status["sensors"]


def test_two_kinds_of_drive_and_a_gateway_make_one_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    """All devices are in memory."""
    all_of_it_moves(calm.calm_text(robot="frankenstein"), monkeypatch)


def test_they_do_over_three_terminals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two adapters speak fdcanusb, and one slcan for both CANopen drives; all devices are in another process."""
    with at_terminals(tmp_path) as (text, _):
        all_of_it_moves(text, monkeypatch)


def test_a_touch_turns_the_joints_round_in_the_tick_that_reads_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the gateway's input to the torque at the drives, while the plan goes on."""
    palm = 'name = "palm_touch"\ndevice = "hand_inputs"\nkind = "digital"\nchannel = '
    text = calm.calm_text({f"{palm}0": f"{palm}5"}, robot="frankenstein")  # this one goes on every 1.9 s
    with running(text, monkeypatch) as (_, robot):
        touch = robot.spine.sensor_names.index("palm_touch")
        robot.swap(ROOT / "laws/reflex.cpp", params={"sensor": touch, "kp_nm_rad": 4, "hold_s": 0.1}, error_ratio=0)
        with Recorder("arm") as recorder:
            robot.go_to([0.3] * robot.spine.joint_count, in_s=4.0)
            time.sleep(4.0)
            records = recorder.finish()
        assert robot.status()["law"] == "reflex"
    on = records["sensor"][:, touch] >= 0.5
    touched = np.flatnonzero(on[1:] & ~on[:-1] & (records["tick"][1:] == records["tick"][:-1] + 1)) + 1
    upwards = records["setpoint_velocity_rad_s"][:, : robot.spine.joint_count] > 0.05
    touched = touched[upwards[touched].all(axis=1)]
    assert len(touched) >= 1
    assert (records["probe"][touched, 0] > 0).all() and (records["probe"][touched - 1, 0] == 0).all()
    torque_nm = records["command_torque_nm"][:, : robot.spine.joint_count]
    assert (torque_nm[touched] < torque_nm[touched - 1]).all(), "each joint, against its motion, in this tick"


def swap_often(robot: lithe.Robot, laws: list[str], swaps: int) -> tuple[npt.NDArray[Any], list[int]]:
    """What was recorded while two laws took turns on a robot that moves, and the ticks of the commits."""
    recorder, commits = Recorder("arm"), []
    for i in range(swaps):
        robot.go_to([0.1 * math.sin(0.3 * i)] * robot.spine.joint_count, in_s=0.2)
        commits.append(robot.swap(laws[i % 2], error_ratio=0)["commit_tick"])
        time.sleep(0.1)
    records = recorder.finish()
    assert recorder.lost == 0 and len(set(commits)) == swaps
    return records, commits


def compared(records: npt.NDArray[Any], commits: list[int]) -> losses.Comparison:
    """Windows around the commits beside the others of the same run."""
    windows = [(at - BEFORE_NS, at + AFTER_NS) for at in (losses.commit_ns(records, tick) for tick in commits)]
    others = losses.elsewhere((windows[0][0], windows[-1][1]), windows, BEFORE_NS + AFTER_NS)
    return losses.compare(losses.releases(records, 1_000_000), windows, others)


@contextlib.contextmanager
def stalled_at_each_commit(robot: lithe.Robot) -> Iterator[None]:
    """A broken twin of swapping: whenever another law runs, its Spine stands still for a moment."""
    spine = int(robot.spine.mapping.header().writer_pid)
    over = threading.Event()

    def watch() -> None:
        law = robot.telemetry.latest()["law_id"]
        while not over.is_set():
            if (now := robot.telemetry.latest()["law_id"]) != law:
                law = now
                os.kill(spine, signal.SIGSTOP)
                time.sleep(STALL_S)
                os.kill(spine, signal.SIGCONT)
            time.sleep(0.0005)

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield
    finally:
        over.set()
        watcher.join()


@pytest.mark.alone
def test_a_swap_on_twelve_joints_loses_nothing(monkeypatch: pytest.MonkeyPatch, tell: Callable[[str], None]) -> None:
    """Five buses, twelve drives, 1 kHz, released as the robot's file has it.

    Ticks are lost near a swap no more often than elsewhere. The same comparison refutes swaps that cost ticks.
    """
    with running(calm.calm_text(calm.SPINS, robot="quadruped"), monkeypatch) as (_, robot):
        assert float(robot.spine.info["rate_hz"]) == 1000.0
        laws = [(ROOT / f"laws/{name}.cpp").read_text() for name in ("pd", "gravity_pd")]
        for source in laws:
            robot.swap(source, error_ratio=0)
        records, commits = swap_often(robot, laws, SWAPS)
        with stalled_at_each_commit(robot):
            broken = compared(*swap_often(robot, laws, STALLED_SWAPS))
    told = compared(records, commits)
    tell(
        f"{told.at_events} of {told.events} swap windows with a lost tick, elsewhere {told.between} of {told.others} "
        f"({told.would_show(SURE)} would have failed)"
    )
    tell(f"stalled on purpose: {broken.at_events} of {broken.events}, elsewhere {broken.between} of {broken.others}")
    assert records["joint_count"][-1] == 12 and told.others > SWAPS
    assert told.chance >= SURE, str(told)
    assert broken.chance < SURE, f"a stall of {STALL_S} s at each swap went unseen: {broken}"
    assert np.isfinite(records["command_torque_nm"]).all()
