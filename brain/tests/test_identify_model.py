# SPDX-License-Identifier: Apache-2.0
"""Robots with a model file: Pinocchio's equations beside ours, and one that is no planar chain."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chain_sim import ENCODER_RAD, STEP_S, Chains, as_recorded
from lithe.errors import LitheError
from lithe.gateway.references import curve_of
from lithe.identify import ChainFit, Model, Motion, describe_model, identify_chain
from lithe.identify.__main__ import main
from lithe.identify.design import information

NAMES = ("roll", "hip", "knee")
# Axes that are no parallels: `roll` tilts the plane in which the others swing, and carries the hip beside its axis.
LEG = """<mujoco><option gravity="0 0 -9.81"/><worldbody>
<body pos="0 0 1"><joint name="roll" axis="1 0 0" armature="0.002"/>
 <inertial pos="0.02 0.05 -0.03" mass="0.5" diaginertia="8e-4 9e-4 7e-4"/>
 <body pos="0.03 0.08 -0.02"><joint name="hip" axis="0 1 0" armature="0.002"/>
  <inertial pos="0.01 0.02 -0.1" mass="0.4" diaginertia="2e-3 2e-3 3e-4"/>
  <body pos="0 0.02 -0.2"><joint name="knee" axis="0 1 0" armature="0.001"/>
   <inertial pos="0.01 0 -0.08" mass="0.2" diaginertia="6e-4 6e-4 1e-4"/>
</body></body></body></worldbody></mujoco>"""
REFERENCE = {
    "kind": "multisine", "centre_rad": [0.2, -0.1, 0.1], "amplitude_rad": [1.0, 1.1, 1.2],
    "frequency_hz": [0.3, 0.7, 1.1, 1.9],
}  # fmt: skip
VISCOUS, COULOMB = np.array([0.03, 0.02, 0.01]), np.array([0.03, 0.02, 0.02])


@pytest.fixture(scope="module")
def leg(pin: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("leg") / "leg.xml"
    path.write_text(LEG)
    return path


def recorded(pin: Any, robot: Any, seconds: float) -> list[Motion]:
    """It follows REFERENCE under a PD, computed by the algorithm of articulated bodies; one tick a step."""
    data, t = robot.createData(), np.arange(round(seconds / STEP_S)) * STEP_S
    wanted = curve_of(REFERENCE, 3)(t)
    q, v = wanted[0].copy(), np.zeros(3)
    angles, torques = np.zeros_like(wanted), np.zeros_like(wanted)
    parts = 4
    for n in range(len(t)):
        torque = 30.0 * (wanted[n] - q) - 0.4 * v
        angles[n], torques[n] = q, torque
        for _ in range(parts):
            h = STEP_S / parts

            def slope(q: Any, v: Any, torque: Any = torque) -> Any:
                return np.array(pin.aba(robot, data, q, v, torque - VISCOUS * v - COULOMB * np.tanh(v / 0.02)))

            middle = v + h / 2 * slope(q, v)
            q, v = q + h * middle, v + h * slope(q + h / 2 * v, middle)
    torques = np.concatenate((torques[:1], torques[:-1])) + 0.01 * np.random.default_rng(1).standard_normal(
        angles.shape
    )
    angles = np.floor(angles / ENCODER_RAD) * ENCODER_RAD
    return [Motion(t, angles[:, k], np.zeros(len(t)), torques[:, k]) for k in range(3)]


Found = tuple[Model, ChainFit, list[Motion]]


@pytest.fixture(scope="module")
def found(pin: Any, leg: Path) -> Found:
    """A leg that is heavier than its file says, and what was found of it."""
    model, robot = describe_model(leg), pin.buildModelFromMJCF(str(leg))
    for inertia in list(robot.inertias)[1:]:
        inertia.mass *= 1.3
    motion = recorded(pin, robot, 10.0)
    return model, identify_chain(model, [motion]), motion


def as_urdf(made: Chains, path: Path) -> Path:
    """The first of these chains: it hangs down, turns about -y (so that angles grow as in the regressor's cosines)."""
    links, joints = '<link name="base"/>', ""
    for k in range(3):
        mass, centre, inertia = (float(getattr(made, name)[0, k]) for name in ("mass_kg", "centre_m", "inertia_kg_m2"))
        about = f'ixx="{inertia!r}" iyy="{inertia!r}" izz="1e-6" ixy="0" ixz="0" iyz="0"'
        links += (f'<link name="link{k}"><inertial><origin xyz="0 0 {-centre!r}"/><mass value="{mass!r}"/>'
                  f"<inertia {about}/></inertial></link>")  # fmt: skip
        above = -float(made.length_m[0, k - 1]) if k else 0.0
        joints += (f'<joint name="joint{k}" type="continuous"><parent link="{f"link{k - 1}" if k else "base"}"/>'
                   f'<child link="link{k}"/><origin xyz="0 0 {above!r}"/><axis xyz="0 -1 0"/></joint>')  # fmt: skip
    path.write_text(f'<robot name="chain">{links}{joints}</robot>')
    return path


@pytest.mark.long
def test_our_chain_and_pinocchio_have_the_same_momenta_forces_and_sums(pin: Any, tmp_path: Path) -> None:
    made = Chains.drawn(1, 3, seed=3)
    ours = made.description(0)
    theirs = describe_model(as_urdf(made, tmp_path / "chain.urdf"))
    q, v = np.random.default_rng(4).uniform(-2, 2, (2, 200, 3))
    truth = made.truth(0)
    mine = np.array([truth[joint, name] for joint, name, _ in ours.rigid_names()])
    its = np.array(theirs.file_values)
    names = [(joint, name) for joint, name, _ in theirs.rigid_names()]
    for k, rotor in enumerate(made.rotor_kg_m2[0]):  # no key of a URDF says it; the first one is in an inertia
        its[names.index((f"joint{k}", "rotor" if k else "inertia_yy"))] += rotor
    sideways = [k for k, (_, name) in enumerate(names) if name == "moment_x"]
    assert len(sideways) == 3 and its[sideways] == pytest.approx(0.0, abs=1e-12), "centres beside the line of a link"
    assert len(its) == len(mine) + 3
    for own, other in zip(ours.rigid(q, v), theirs.rigid(q, v), strict=True):
        own_nm, other_nm = (np.einsum("npk,p->nk", each, by) for each, by in ((own, mine), (other, its)))
        assert np.abs(own_nm).max() > 0.1
        assert other_nm == pytest.approx(own_nm, abs=1e-9)


@pytest.mark.long
def test_a_leg_that_is_no_planar_chain_is_found(pin: Any, leg: Path, found: Found, tell: Any) -> None:
    model, fit, _ = found
    robot = pin.buildModelFromMJCF(str(leg))
    text = leg.read_text()
    for mass in (0.5, 0.4, 0.2):
        text = text.replace(f'mass="{mass}"', f'mass="{1.3 * mass}"')
    heavier = leg.with_name("heavier.xml")
    heavier.write_text(text)
    truth = dict(zip(model.rigid_names(), describe_model(heavier).file_values, strict=True))
    errors = {
        (joint, name): (fit[joint, name].value - true) / fit[joint, name].error
        for (joint, name, _), true in truth.items()
    }
    held = np.mean([abs(each) < 1.96 for each in errors.values()])
    tell(f"{len(errors)} sums of {10 * robot.nv} parameters, {held:.0%} in their intervals; {fit.condition:.0f}")
    assert held >= 0.8 and max(map(abs, errors.values())) < 4, errors
    assert fit["hip", "viscous"].value == pytest.approx(VISCOUS[1], rel=0.2)
    assert max(fit.residual_nm.values()) < 0.01


@pytest.mark.long
def test_what_is_found_gives_torques_of_the_leg_that_the_file_does_not(pin: Any, found: Found, tell: Any) -> None:
    """Every sum has its share: weights for where the leg rests."""
    model, fit, _ = found
    q = np.random.default_rng(5).uniform(-1.5, 1.5, (100, 3))
    _, pull = model.rigid(q, np.zeros_like(q))
    identified = np.array([fit[joint, name].value for joint, name, _ in model.rigid_names()])
    true_nm, found_nm, file_nm = (np.einsum("npk,p->nk", pull, values) for values in (
        1.3 * np.array(model.file_values), identified, np.array(model.file_values)))  # fmt: skip
    off_nm, file_off_nm = (float(np.abs(each - true_nm).max()) for each in (found_nm, file_nm))
    tell(f"weights: off by {off_nm:.4f} N m of {np.abs(true_nm).max():.2f}, the file by {file_off_nm:.2f}")
    assert off_nm < 0.03 * np.abs(true_nm).max() < file_off_nm


@pytest.mark.long
def test_other_orders_of_joints_are_the_same_robot(leg: Path, found: Found) -> None:
    model, _, motion = found
    turned = describe_model(leg, ("knee", "roll", "hip"))
    fit = identify_chain(turned, [[motion[2], motion[0], motion[1]]])
    for joint, name, _ in model.rigid_names():
        assert fit[joint, name].value == pytest.approx(found[1][joint, name].value, rel=1e-3, abs=1e-6)


@pytest.mark.long
def test_a_motion_can_be_designed_for_it(leg: Path, pin: Any) -> None:
    model = describe_model(leg)
    usual, slow = (information(model, {**REFERENCE, "amplitude_rad": size}, 4.0) for size in (1.0, 0.2))
    assert usual > slow > -np.inf


@pytest.mark.long
def test_the_command_prints_what_the_file_says_beside_it(
    leg: Path, found: Found, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "motion.npy", as_recorded(found[2]))
    joints = "".join(f'[[joint]]\nname = "{name}"\n' for name in NAMES)
    robot, real = tmp_path / "leg.toml", tmp_path / "real.toml"
    robot.write_text(f'[plant]\nkind = "mujoco"\nmodel = "{leg}"\n{joints}')
    real.write_text(joints)
    data = str(tmp_path / "motion.npy")
    assert main([str(robot), data]) == 0
    assert "(file: " in capsys.readouterr().out
    assert main([str(real), data, "--model", str(leg), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert len(told["file_values"]) < len(told["parameters"])
    assert main([str(robot), data, "--write", str(tmp_path / "new.toml")]) == 2
    assert "change the file by what is printed" in capsys.readouterr().err


@pytest.mark.long
def test_models_that_are_of_another_robot_are_refused(leg: Path, pin: Any, tmp_path: Path) -> None:
    with pytest.raises(LitheError, match="the joints of .* are roll, hip, knee, those of the robot roll, hip"):
        describe_model(leg, ("roll", "hip"))
    with pytest.raises(LitheError, match="Pinocchio cannot read"):
        describe_model(tmp_path / "missing.urdf")
    ball = tmp_path / "ball.xml"
    ball.write_text(LEG.replace('name="hip" axis="0 1 0"', 'name="hip" type="ball"'))
    with pytest.raises(LitheError, match="one hinge or slide"):
        describe_model(ball)


def test_without_pinocchio_the_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    with pytest.raises(LitheError, match="pip install pin"):
        describe_model("any.urdf")


def test_what_pinocchio_throws_is_told_with_the_file(pin: Any, tmp_path: Path) -> None:
    """Two unnamed defaults (an IndexError in Pinocchio), no XML, no URDF: never a traceback."""
    two = "".join(f'<default><default class="{name}"><joint damping="1"/></default></default>' for name in "ab")
    leg = LEG.replace("<worldbody>", two + "<worldbody>").replace('name="roll"', 'name="roll" class="b"')
    for name, text in [("two.xml", leg), ("text.xml", "a leg"), ("empty.urdf", "")]:
        path = tmp_path / name
        path.write_text(text)
        with pytest.raises(LitheError, match=name):
            describe_model(path, NAMES)
