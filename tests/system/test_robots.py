# SPDX-License-Identifier: Apache-2.0
"""Robots beside the desk arm: over a serial adapter, of two kinds of drive, with twelve joints."""

import json
import math
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
