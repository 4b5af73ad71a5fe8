# SPDX-License-Identifier: Apache-2.0
"""The parameters of robots/chain.toml, from the telemetry of its Spine and by the command that a user types."""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import calm
import numpy as np
import pytest
from lithe.demo.recorder import Recorder
from lithe.gateway.references import References
from lithe.identify import describe, design_multisine
from lithe.shm import dtype
from system.robot_rig import ROOT
from system.simulated import running

SECONDS = 12.0


def truth() -> dict[tuple[str, str], float]:
    """Of the file's links, as lithe/identify/regressor.py defines them; the last link is a thin rod."""
    length, mass, centre = np.array([0.25, 0.2, 0.12]), np.array([0.35, 0.25, 0.08]), np.array([0.16, 0.13, 0.06])
    inertia, rotor = np.array([2.5e-3, 1.2e-3, 0.08 * 0.12**2 / 12]), 2.0e-3
    beyond = np.array([mass[k + 1 :].sum() for k in range(3)])
    moment, about = mass * centre + beyond * length, inertia + mass * centre**2 + beyond * length**2
    about[0] += rotor
    names = ("shoulder", "elbow", "wrist")
    return {(name, what): float(values[k]) for k, name in enumerate(names)
            for what, values in (("moment", moment), ("inertia", about))}  # fmt: skip


def test_a_designed_motion_tells_the_chain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tell: Callable[[str], None]
) -> None:
    chain = ROOT / "robots/chain.toml"
    with running(calm.calm_text(robot="chain"), monkeypatch) as (_, robot):
        references = References(robot)
        design = design_multisine(describe(chain), references.limits(), seconds=SECONDS, candidates=20)
        recorder = Recorder("arm")
        references.set({**design["reference"], "stay": True})
        time.sleep(SECONDS)
        assert references.told()["streams"], (references.told(), robot.status()["alarms"])
        references.stop()
        records = recorder.finish()
    np.save(tmp_path / "motion.npy", records)
    done = subprocess.run(
        [sys.executable, "-m", "lithe.identify", chain, tmp_path / "motion.npy", "--json"],
        env={"PYTHONPATH": str(ROOT / "brain")}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = {(each["joint"], each["name"]): each for each in json.loads(done.stdout)["parameters"]}
    for key, true in truth().items():
        each = found[key]
        tell(f"{' '.join(key)}: {each['value']:.4g} +- {1.96 * each['error']:.2g} {each['unit']}, true {true:.4g}")
        # Of the drive's model nothing is known here but its delay: an interval may miss by a little.
        assert abs(each["value"] - true) < max(3 * each["error"], 0.03 * true), key


def test_what_is_no_telemetry_is_named(tmp_path: Path) -> None:
    np.save(tmp_path / "other.npy", np.zeros(3))
    (tmp_path / "text.npy").write_text("what a person wrote")
    telemetry = np.zeros(4, dtype=dtype("Telemetry"))
    telemetry["joint_count"] = 3
    np.save(tmp_path / "chain.npy", telemetry)
    np.save(tmp_path / "empty.npy", telemetry[:0])
    for words, code, says in (
        ([ROOT / "robots/chain.toml", tmp_path / "other.npy"], 2, "no telemetry of the robot"),
        ([ROOT / "robots/chain.toml", tmp_path / "missing.npy"], 2, "No such file"),
        ([ROOT / "robots/arm.toml", tmp_path / "other.npy"], 2, "no telemetry of the robot"),
        ([ROOT / "robots/arm.toml", tmp_path / "text.npy"], 2, "it is no .npy file"),
        ([ROOT / "robots/arm.toml", tmp_path / "chain.npy"], 2, "it has 3 joints, the robot 1"),
        ([ROOT / "robots/chain.toml", tmp_path / "empty.npy"], 2, "it is empty"),
        ([tmp_path / "other.npy", tmp_path / "other.npy"], 2, "give a robot file"),
        ([ROOT / "robots/chain.toml", tmp_path / "missing.npy", "--write", tmp_path / "new.toml"], 2, "No such file"),
        (
            [ROOT / "robots/chain.toml", tmp_path / "other.npy", "--write", ROOT / "robots/arm.toml"],
            2,
            "stays as it is",
        ),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "lithe.identify", *words],
            env={"PYTHONPATH": str(ROOT / "brain")}, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == code and says in done.stderr, done.stderr
    assert not (tmp_path / "new.toml").exists()
