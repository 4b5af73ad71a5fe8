# SPDX-License-Identifier: Apache-2.0
"""How the agent moves joints: within their limits, all to their heaviest place at once; and the laws that do it."""

import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arm_sim import SimArm
from lithe.demo import moves, sources
from lithe.demo.joints import most_share
from lithe.demo.sources import Gains
from lithe.files import robot_table
from lithe.gateway import references
from lithe.gateway.client import MOST_REQUEST_BYTES
from lithe.identify import Arm, Motion
from system.robot_rig import ROOT

LIMITS = ("position_min_rad", "position_max_rad", "velocity_max_rad_s")


def joints_of(robot: str) -> list[dict[str, Any]]:
    """As `describe` tells them."""
    joints = robot_table((ROOT / f"robots/{robot}.toml").read_text(encoding="utf-8"))["joint"]
    return [{"name": joint["name"], **{key: joint[key] for key in LIMITS}} for joint in joints]


def reference(robot: str) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    joints = joints_of(robot)
    return joints, moves.sines(joints)


def test_the_arms_sine_is_the_wide_one() -> None:
    _, sine = reference("arm")
    assert (sine["centre_rad"], sine["amplitude_rad"]) == ([np.pi / 2], [np.pi / 4])
    assert sine["phase_rad"] == [0.0] and (sine["frequency_hz"], sine["ramp_s"]) == (0.5, 1.5)


@pytest.mark.parametrize("robot", ["arm", "arm8", "arm32", "frankenstein", "quadruped"])
def test_every_joint_stays_within_its_limits_and_comes_to_its_heaviest_place(robot: str) -> None:
    joints, sine = reference(robot)
    assert sine["kind"] == "sine"
    curve = references.curve_of({name: sine[name] for name in sine if name != "ramp_s"}, len(joints))
    rest = np.zeros(len(joints))
    keeper = references.Reference(0, rest, rest, curve, sine["ramp_s"])
    times = np.arange(0, 6_000_000_000, 5_000_000)
    angles = keeper.at([int(t) for t in times])
    assert angles.shape == (len(times), len(joints))
    heaviest = keeper.at([5_000_000_000])[0]  # half a turn of the sine, two and a half periods on
    for j, joint in enumerate(joints):
        assert joint["position_min_rad"] < angles[:, j].min() and angles[:, j].max() < joint["position_max_rad"]
        assert np.abs(np.diff(angles[:, j])).max() / 0.005 < joint["velocity_max_rad_s"]
        steady = angles[times > 2_000_000_000, j]
        assert np.ptp(steady) > 0.4, "wide enough to tell something"
        within = np.linspace(joint["position_min_rad"] + 0.15, joint["position_max_rad"] - 0.15, 1001)
        assert abs(np.sin(heaviest[j])) == pytest.approx(np.abs(np.sin(within)).max(), abs=1e-3), joint["name"]


WIDE = {"velocity_max_rad_s": 15.0}


@pytest.mark.parametrize(
    ("least_rad", "most_rad", "loaded_rad"),
    [
        (-3.0, 3.0, np.pi / 2),
        (-2.0, 0.3, -np.pi / 2),
        (-0.3, 2.0, np.pi / 2),
        (-1.2, 0.1, -1.05),
        (-0.4, 0.4, 0.25),
        (-0.4, 0.3, -0.25),
        (-6.0, 1.0, -np.pi / 2),
        (0.9, 1.3, 1.15),
        (1.8, 5.0, 3 * np.pi / 2),
    ],
)
def test_what_a_joint_is_asked_to_bear_is_what_it_comes_to_bear(
    least_rad: float, most_rad: float, loaded_rad: float
) -> None:
    """The agent's sine, stopped as the experiment stops it, beside what the judge asks of a joint with these limits."""
    sine = moves.sines([{"position_min_rad": least_rad, "position_max_rad": most_rad, **WIDE}])
    centre, amplitude, phase = (sine[key][0] for key in ("centre_rad", "amplitude_rad", "phase_rad"))
    assert least_rad + 0.149 < centre - amplitude and centre + amplitude < most_rad - 0.149
    half_a_turn = centre + amplitude * np.sin(np.pi + phase)
    assert half_a_turn == pytest.approx(loaded_rad)
    speed = amplitude * np.cos(np.pi + phase)
    assert speed * np.sin(loaded_rad) < 1e-9, "the way that gravity pulls"
    early = np.pi - 0.1  # the setpoints of joints with other decelerations coast a little farther, or less far
    stopped = centre + amplitude * np.sin(early + phase)
    for soft_stop_rad in (0.0, 0.1):
        assert abs(np.sin(stopped)) > 0.93 * most_share(least_rad, most_rad, soft_stop_rad)


def test_limits_turned_over_turn_the_sine_over() -> None:
    joints = joints_of("frankenstein")
    over = [{**one, LIMITS[0]: -one[LIMITS[1]], LIMITS[1]: -one[LIMITS[0]]} for one in joints]
    one_sided = [j for j, one in enumerate(joints) if one[LIMITS[0]] != -one[LIMITS[1]]]
    assert len(one_sided) == 2, "elbow and hand"
    usual, turned = moves.sines(joints), moves.sines(over)
    for j in one_sided:
        assert turned["centre_rad"][j] == -usual["centre_rad"][j]
        assert np.sin(turned["phase_rad"][j]) == pytest.approx(-np.sin(usual["phase_rad"][j]))
        assert np.cos(turned["phase_rad"][j]) == pytest.approx(-np.cos(usual["phase_rad"][j]))


def test_a_joint_without_room_is_named() -> None:
    with pytest.raises(ValueError, match="'wedge' has no room"):
        moves.sines([{"name": "wedge", "position_min_rad": 0.0, "position_max_rad": 0.2, "velocity_max_rad_s": 1.0}])


ARM = Arm(0.2, 1e-4, 0.0, 3e-3, 1e-6, 1e-4, 0.016, 1e-4, 100)
STILL = Motion(np.arange(50.0), np.full(50, 0.3), np.zeros(50), np.zeros(50))


@pytest.mark.parametrize(
    ("least_rad", "most_rad", "shares"),
    [
        (-3.0, 3.0, moves.PROBE_SHARES),
        (-0.2, 2.4, (0.5, 0.25)),
        (-2.4, 0.7, (-0.5, -0.25)),
        (-0.5, 0.6, None),
        (0.9, 2.4, None),
    ],
)
def test_the_probes_leave_no_joint_beyond_its_limits(least_rad: float, most_rad: float, shares: Any) -> None:
    joint = {"position_min_rad": least_rad, "position_max_rad": most_rad}
    chosen = moves.probe_shares(ARM, STILL, joint)
    assert chosen == shares
    if chosen is None:
        return
    arm = SimArm(mgl_nm=0.2, inertia_kg_m2=3e-3, coulomb_nm=0.016, angle_rad=0.3)
    for share in chosen:
        moved = arm.run(lambda t_s, _q, _v, share=share: share * 0.2 * min(1.0, t_s / 0.05), 4.0)
        assert least_rad < moved.position_rad.min() and moved.position_rad.max() < most_rad


def test_a_joint_that_is_thrown_is_not_probed() -> None:
    fast = Motion(STILL.t_s, STILL.position_rad, np.full(50, 20.0), STILL.torque_nm)
    assert moves.probe_shares(ARM, fast, {"position_min_rad": -3.0, "position_max_rad": 3.0}) is None


NAMES = ["column", "boom */ \\", "wrist"]
GAINS = [Gains(1.0, 0.1), Gains(2.0, 0.2), Gains(0.05, 0.004)]
WRITTEN = {
    "baseline": sources.baseline(NAMES, GAINS, "now"),
    "probe": sources.probe(1, NAMES, [None, 0.75, -0.06], GAINS),
    "evolved": sources.model("evolved", sources.EVOLVED, NAMES, [ARM] * 3, GAINS),
    "one": sources.model("gravity_only", sources.GRAVITY_ONLY, NAMES[:1], [ARM], GAINS[:1]),
    "most": sources.model("evolved", sources.EVOLVED, ["j"] * 32, [ARM] * 32, GAINS[:1] * 32),
}


@pytest.mark.parametrize("law", WRITTEN)
def test_every_law_the_agent_writes_compiles_without_a_warning(tmp_path: Path, law: str) -> None:
    (tmp_path / "law.cpp").write_text(WRITTEN[law], encoding="utf-8")
    command = ["g++", "-std=c++20", "-Wall", "-Wextra", "-Wshadow", "-Wconversion", "-Wno-sign-conversion", "-Werror"]
    include = ["-I", ROOT / "spine/law/include", "-fsyntax-only"]
    done = subprocess.run([*command, *include, tmp_path / "law.cpp"], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_joint_is_probed_or_follows() -> None:
    rows = [line.strip() for line in WRITTEN["probe"].splitlines() if line.startswith("      {")]
    assert rows == ["{0, 1, 0.1},  // column", "{0.75, 0, 0},  // boom?????", "{-0.06, 0, 0},  // wrist"]


def test_the_law_with_most_joints_fits_into_a_request() -> None:
    assert len(WRITTEN["most"]) < MOST_REQUEST_BYTES / 64
