# SPDX-License-Identifier: Apache-2.0
"""The agent's estimate of robots/arm.toml, over 50 seeds of what no model of the arm knows: its interval holds."""

import json
import subprocess
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import calm
import numpy as np
import pytest
from lithe.demo.moves import PROBE_SHARES
from lithe.identify import Arm, Motion, identify_arm
from system.robot_rig import BIN, need

SEEDS = 50
LEAST_COVERED = 0.9  # of intervals that shall cover in 95 of 100: fewer happen by accident in 4 of 100 such tests
ROUGH_NM = 0.165  # what the agent reads from its baseline, about: it chooses the torques of its probes by it


@dataclass(frozen=True)
class Case:
    """What was found of one arm, and what it is [N m], in the torque that its drive tells."""

    found: Arm
    true_nm: float
    file_nm: float  # as the robot file says, without payload and the error of the drive's torque constant

    def covers(self, true_nm: float) -> bool:
        least_nm, most_nm = self.found.mgl_interval_nm
        return least_nm <= true_nm <= most_nm


def estimate(folder: Path, seed: int, ideal: bool) -> Case:
    text = calm.calm_text({"seed = 1 ": f"seed = {seed} "}, ideal=ideal)
    robot = folder / f"arm_{seed}_{ideal}.toml"
    robot.write_text(text, encoding="utf-8")
    told = subprocess.run([BIN / "lithe-sim", "--truth", robot], check=True, capture_output=True, timeout=60)
    torques = [f"{share * ROUGH_NM:.6f}" for share in PROBE_SHARES]
    ran = subprocess.run([BIN / "probing_peer", robot, *torques], check=True, capture_output=True, timeout=120)
    rows = np.frombuffer(ran.stdout, dtype="<f8").reshape(-1, 5)
    parts = [rows[rows[:, 0] == phase] for phase in range(3)]
    found = identify_arm([Motion(*(np.array(column) for column in part[:, 1:].T)) for part in parts])
    return Case(found, float(json.loads(told.stdout)["joints"][0]["mgl_told_nm"]), 0.165)


def estimates(folder: Path, ideal: bool) -> list[Case]:
    need("probing_peer", "lithe-sim")
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(lambda seed: estimate(folder, seed, ideal), range(1, SEEDS + 1)))


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> list[Case]:
    return estimates(tmp_path_factory.mktemp("seeds"), ideal=False)


def share(cases: list[Case], holds: Callable[[Case], bool]) -> float:
    return sum(map(holds, cases)) / len(cases)


def test_the_interval_covers_the_truth(cases: list[Case], tell: Callable[[str], None]) -> None:
    covered = share(cases, lambda case: case.covers(case.true_nm))
    off = [case.found.mgl_nm / case.true_nm - 1 for case in cases]
    half = [case.found.mgl_interval_nm[1] / case.found.mgl_nm - 1 for case in cases]
    tell(
        f"{covered:.0%} of {len(cases)} intervals cover the truth; they are +-{np.mean(half):.1%} wide, "
        f"the estimate is off by {np.mean(off):+.1%} on average, {np.max(np.abs(off)):.1%} at most"
    )
    assert covered >= LEAST_COVERED
    assert np.max(half) < 0.05, "an interval that says little covers everything"


def test_an_interval_half_as_wide_is_refuted(cases: list[Case]) -> None:
    def halved(case: Case) -> bool:
        return replace(case, found=replace(case.found, mgl_se_nm=case.found.mgl_se_nm / 2)).covers(case.true_nm)

    assert share(cases, halved) < LEAST_COVERED


def test_a_truth_that_is_shifted_by_two_percent_is_refuted(cases: list[Case]) -> None:
    for factor in (0.98, 1.02):
        assert share(cases, lambda case, factor=factor: case.covers(factor * case.true_nm)) < LEAST_COVERED


def test_what_the_robot_file_says_without_its_errors_is_not_the_truth(cases: list[Case]) -> None:
    """The arm no longer flatters: payload and torque constant are in what is measured."""
    assert share(cases, lambda case: case.covers(case.file_nm)) < 0.5
    assert np.std([case.true_nm for case in cases]) > 0.02 * 0.165, "the seeds draw different arms"


def test_an_ideal_robot_is_what_its_file_says(tmp_path: Path) -> None:
    case = estimate(tmp_path, 1, ideal=True)
    assert case.true_nm == 0.165
    assert abs(case.found.mgl_nm / 0.165 - 1) < 0.01


def test_the_same_seed_is_the_same_arm(tmp_path: Path) -> None:
    assert estimate(tmp_path, 7, ideal=False) == estimate(tmp_path, 7, ideal=False)
