# SPDX-License-Identifier: Apache-2.0
"""Robots beside the desk arm: over a serial adapter, of two kinds of drive, with twelve joints."""

import json
import math
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import calm
import numpy as np
import pytest
from calm import connected
from lithe.demo import losses
from lithe.demo.recorder import Recorder
from system.house import ROOT, House
from system.simulated import Simulated

PATIENT = "lost_after_misses = 2000\n"  # a simulated device is a process among others here
SWAPS = 60
BEFORE_NS, AFTER_NS = 5_000_000, 6_000_000
SURE = 1e-4


def as_arm(robot: str) -> str:
    """That robot's file, patient and under the name by which the tests' house finds it."""
    text = (ROOT / f"robots/{robot}.toml").read_text(encoding="utf-8").replace('"../laws/', f'"{ROOT}/laws/')
    text = text.replace(f'name = "{robot}"', 'name = "arm"', 1)
    text = text if "[guard]\n" in text else text.replace("[defaults.device]", "[guard]\n\n[defaults.device]", 1)
    text = text.replace("[guard]\n", f"[guard]\n{PATIENT}", 1)
    sections = '[spine]\nrelease = "sleep"\nlate_ticks_to_stop = 10000\n\n[brain]\nstale_after_s = 2.0\n\n'
    return text.replace("[defaults.device]", sections + "[defaults.device]", 1).replace(
        "watchdog_s = 0.1 ", "watchdog_s = 5.0 "
    )


def test_the_demo_runs_unchanged_over_an_fdcanusb(tmp_path: Path, tell: Callable[[str], None]) -> None:
    """The simulated drive is in another process, at the far end of a serial device."""
    sim = Simulated(ROOT / "robots/arm.toml", tmp_path / "buses")
    try:
        path = sim.path()
        changes = {'kind = "loop" ': f'kind = "fdcanusb"\npath = "{path}" ', "[guard]  ": f"[guard]\n{PATIENT}# "}
        robot = tmp_path / "usb.toml"
        robot.write_text(calm.calm_text(changes), encoding="utf-8")
        done = subprocess.run(
            [sys.executable, "-m", "lithe.demo", "--robot", robot, "--out", tmp_path / "out"],
            check=False, capture_output=True, text=True, timeout=400, cwd=ROOT,
        )  # fmt: skip
    finally:
        sim.close()
    assert (tmp_path / "out/summary.json").exists(), done.stdout + done.stderr
    summary: dict[str, Any] = json.loads((tmp_path / "out/summary.json").read_text())
    lost = f"{summary['lost_ticks']} of {summary['ticks']} ticks lost"
    tell(f"RMSE of the last law {summary['phases'][-1]['rmse_deg']:.2f} deg, {lost}")
    assert calm.falls_short(summary) == [], done.stdout


@pytest.fixture
def house(tmp_path: Path) -> House:
    """An empty house; the test says which robot lives there."""
    return House()


def test_two_kinds_of_drive_and_a_gateway_make_one_robot(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    """All joints follow one plan under one law; sensors have names and values; a swap takes all of it along."""
    house.config = house.dir / "arm.toml"
    house.config.write_text(as_arm("frankenstein"), encoding="utf-8")
    for key in ("LITHE_RUN_DIR", "LITHE_SHM_PREFIX", "LITHE_OUT_DIR"):
        monkeypatch.setenv(key, house.env[key])
    try:
        house.run()
        house.wait_for(lambda: house.ask("status")["mode"] == "active")
        with connected() as robot:
            joints = robot.spine.joint_count
            robot.go_to([0.3] * joints, in_s=2.0)
            robot.swap((ROOT / "laws/gravity_pd.cpp").read_text(), name="gravity_pd.cpp", error_ratio=0)
            time.sleep(2.5)
            record = robot.telemetry.latest()
            status = robot.status()
        assert (status["mode"], status["law"]) == ("active", "gravity_pd")
        moved = record["position_rad"][:joints]
        assert joints == 7 and (moved > 0.1).all(), moved
        assert status["sensors"] and all(value is not None for value in status["sensors"].values()), status["sensors"]
    finally:
        house.close()


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
    gone = "gravity|length|mass|center|link_inertia|rotor_inertia|viscous|coulomb"
    text = re.sub(rf"(?m)^({gone})_.*\n", "", text)
    return text.replace('kind = "chain" ', f'kind = "mujoco"\nmodel = "{path}" ', 1)


@pytest.mark.parametrize("plant", ["chain", "mujoco"])
def test_joints_that_hang_on_each_other_run_and_swap(
    house: House, monkeypatch: pytest.MonkeyPatch, tell: Callable[[str], None], plant: str
) -> None:
    """The shoulder alone is sent away, and carries the links that hang on it, also under another law."""
    house.config = house.dir / "arm.toml"
    text = as_arm("chain")
    house.config.write_text(as_model(text, house.dir / "arm.xml") if plant == "mujoco" else text, encoding="utf-8")
    for key in ("LITHE_RUN_DIR", "LITHE_SHM_PREFIX", "LITHE_OUT_DIR"):
        monkeypatch.setenv(key, house.env[key])
    try:
        process = house.run(wait=False)
        house.wait_for(lambda: house.socket.exists() or process.poll() is not None, 90.0)
        if process.poll() is not None and "libmujoco-dev" in house.log():
            pytest.skip(house.log().strip().splitlines()[-1])
        house.wait_for(lambda: house.ask("status")["mode"] == "active")
        with connected() as robot:
            at_rest = robot.telemetry.latest()["command_torque_nm"][0]
            robot.go_to([1.2, 0.0, 0.0], in_s=1.5)
            robot.swap((ROOT / "laws/gravity_pd.cpp").read_text(), name="gravity_pd.cpp", error_ratio=0)
            time.sleep(3.0)
            record = robot.telemetry.latest()
            status = robot.status()
    finally:
        house.close()
    assert (status["mode"], status["law"]) == ("active", "gravity_pd")
    position, torque = record["position_rad"][:3], record["command_torque_nm"][:3]
    reach, load_nm = 0.0, 0.0
    for (mass, centre, length, _), angle in zip(LINKS, np.cumsum(position), strict=True):
        load_nm += 9.81 * mass * (reach + centre * np.sin(angle))
        reach += length * np.sin(angle)
    tell(f"at {np.round(position, 2)} rad the shoulder gives {torque[0]:.2f} Nm, {load_nm:.2f} Nm hang on it")
    assert position[0] > 0.4 and abs(at_rest) < 0.2
    assert abs(torque[0] - load_nm) < 0.15


def test_a_swap_on_twelve_joints_loses_nothing(
    house: House, monkeypatch: pytest.MonkeyPatch, tell: Callable[[str], None]
) -> None:
    """Five buses, twelve drives: ticks are lost near a swap no more often than elsewhere."""
    house.config = house.dir / "arm.toml"
    house.config.write_text(as_arm("quadruped"), encoding="utf-8")
    for key in ("LITHE_RUN_DIR", "LITHE_SHM_PREFIX", "LITHE_OUT_DIR"):
        monkeypatch.setenv(key, house.env[key])
    try:
        house.run()
        house.wait_for(lambda: house.ask("status")["mode"] == "active")
        with connected() as robot:
            laws = [(ROOT / f"laws/{name}.cpp").read_text() for name in ("pd", "gravity_pd")]
            for source in laws:
                robot.swap(source, error_ratio=0)
            recorder, commits = Recorder("arm"), []
            for i in range(SWAPS):
                robot.go_to([0.1 * math.sin(0.3 * i)] * robot.spine.joint_count, in_s=0.2)
                commits.append(robot.swap(laws[i % 2], error_ratio=0)["commit_tick"])
                time.sleep(0.1)
            records = recorder.finish()
    finally:
        house.close()
    assert records["joint_count"][-1] == 12 and len(set(commits)) == SWAPS
    windows = [(at - BEFORE_NS, at + AFTER_NS) for at in (losses.commit_ns(records, tick) for tick in commits)]
    others = losses.elsewhere((windows[0][0], windows[-1][1]), windows, BEFORE_NS + AFTER_NS)
    told = losses.compare(losses.releases(records, 1_000_000), windows, others)
    tell(f"{told.at_events} of {told.events} swap windows with a lost tick, elsewhere {told.between} of {told.others}")
    assert recorder.lost == 0 and told.chance >= SURE, str(told)
    assert np.isfinite(records["command_torque_nm"]).all()
