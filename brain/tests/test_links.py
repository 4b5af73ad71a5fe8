# SPDX-License-Identifier: Apache-2.0
"""`lithe model`: what it writes moves as the file it was made from, by Pinocchio's equations of both."""

import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lithe.errors import LitheError
from lithe.model import links_of, with_links
from lithe.model.__main__ import main

ROOT = Path(__file__).resolve().parents[2]
# Six hinges about axes of all directions, a flange that is fixed, and two fingers that the robot does not have.
ARM = """<robot name="arm">
  <link name="base"/>
  {links}
  <link name="flange"><inertial><origin xyz="0.01 0 0.02"/><mass value="0.1"/>
    <inertia ixx="1e-4" iyy="1e-4" izz="2e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="weld" type="fixed"><parent link="link6"/><child link="flange"/>
    <origin xyz="0 0.02 0.1" rpy="0 0.5 0"/></joint>
  <link name="finger"><inertial><mass value="0.03"/>
    <inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="grip" type="prismatic"><parent link="flange"/><child link="finger"/><origin xyz="0 0 0.05"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="0.05" effort="1" velocity="1"/></joint>
</robot>"""
LINK = """<link name="link{n}"><inertial><origin xyz="{com}" rpy="0.3 -0.2 {n}"/><mass value="{mass}"/>
    <inertia ixx="4e-3" iyy="3e-3" izz="2e-3" ixy="2e-4" ixz="-1e-4" iyz="3e-4"/></inertial></link>
  <joint name="j{n}" type="{kind}"><parent link="{parent}"/><child link="link{n}"/><origin xyz="{at}" rpy="{rpy}"/>
    <axis xyz="{axis}"/><dynamics damping="0.0{n}"/><limit lower="-2" upper="2" effort="9" velocity="3"/></joint>"""
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 0.6 -0.8", "0 0 1")
NAMES = [f"j{n}" for n in range(1, 7)]


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    links = []
    for n, axis in enumerate(AXES, 1):
        parent, kind = f"link{n - 1}" if n > 1 else "base", "continuous" if n == 6 else "revolute"
        mass, com, at = 2.2 - 0.3 * n, f"0.02 0.01 0.1{n}", f"0.0{n} -0.02 0.2"
        rpy = f"{0.2 * n} {-0.3 + 0.1 * n} {n}"
        links.append(LINK.format(n=n, parent=parent, kind=kind, axis=axis, mass=mass, com=com, at=at, rpy=rpy))
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(ARM.format(links="\n".join(links)))
    return path


def turned(roll: float, pitch: float, yaw: float) -> Any:
    """As a URDF says: about the fixed x, then y, then z."""
    (sr, cr), (sp, cp), (sy, cy) = ((np.sin(each), np.cos(each)) for each in (roll, pitch, yaw))
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return z @ y @ x


def built(pin: Any, text: str) -> Any:
    """A robot of the tables alone: the defaults of docs/hardware.md, and our own rotations."""
    robot, config = pin.Model(), tomllib.loads(text)
    robot.gravity = pin.Motion(np.array([*config["model"]["gravity_m_s2"], 0, 0, 0]))
    for joint in config["joint"]:
        of = joint["model"]
        axis = np.array(of.get("axis", [0, 0, 1]))
        place = pin.SE3(turned(*of.get("rest_rad", [0, 0, 0])), np.array(of.get("offset_m", [0, 0, 0])))
        parent = 0 if of["parent"] == "base" else robot.getJointId(of["parent"])
        k = robot.addJoint(parent, pin.JointModelRevoluteUnaligned(axis), place, joint["name"])
        xx, yy, zz, xy, xz, yz = of.get("inertia_kg_m2", [0] * 6)
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        robot.appendBodyToJoint(
            k, pin.Inertia(of["mass_kg"], np.array(of.get("center_m", [0, 0, 0])), inertia), pin.SE3.Identity()
        )
    return robot


def worst(pin: Any, ours: Any, theirs: Any) -> float:
    """The largest difference of the torques for 100 random motions, as a share of the largest torque."""
    dice, a, b = np.random.default_rng(3), ours.createData(), theirs.createData()
    share = 0.0
    for _ in range(100):
        q, v, acceleration = dice.uniform(-2, 2, (3, ours.nv))
        at = pin.integrate(theirs, pin.neutral(theirs), q)
        torque = pin.rnea(theirs, b, at, v, acceleration)
        share = max(share, float(np.abs(pin.rnea(ours, a, q, v, acceleration) - torque).max() / np.abs(torque).max()))
    return share


def robot_file(names: list[str]) -> str:
    return 'name = "a"\nrate_hz = 1000\n\n[defaults.joint]\nratio = 6.0\n' + "".join(
        f'\n[[joint]]\nname = "{name}"\ndevice = "{name}_drive"\n# [joint.sim] is below\n[joint.sim]\nmass_kg = 1.0\n'
        for name in names
    )


def test_what_is_written_moves_as_the_file_does(
    pin: Any, arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot, out = tmp_path / "robot.toml", tmp_path / "out.toml"
    robot.write_text(robot_file(NAMES))
    assert main([str(robot), str(arm), "--write", str(out)]) == 0
    assert "the robot has no joint grip: taken as fixed at angle 0" in capsys.readouterr().err
    whole = pin.buildModelFromUrdf(str(arm))
    theirs = pin.buildReducedModel(whole, [whole.getJointId("grip")], pin.neutral(whole))
    text = out.read_text()
    assert worst(pin, built(pin, text), theirs) < 1e-7
    assert [joint["model"]["viscous_nm_s_rad"] for joint in tomllib.loads(text)["joint"]] == [
        0.01 * n for n in range(1, 7)
    ]
    other = text.replace("rest_rad = [0.2, ", "rest_rad = [0.3, ")
    assert other != text and worst(pin, built(pin, other), theirs) > 1e-3, "the comparison sees a wrong angle"


def test_a_tree_of_mjcf_and_the_motors_behind_their_gears(pin: Any, tmp_path: Path) -> None:
    path = tmp_path / "leg.xml"
    path.write_text(
        '<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="A" pos="0 0 1">'
        '<joint name="a" axis="1 0 0" armature="0.002" damping="0.1"/>'
        '<inertial pos="0.02 0.05 -0.03" mass="0.5" diaginertia="8e-4 9e-4 7e-4"/>'
        '<body name="B" pos="0.03 0.08 -0.02" euler="10 20 30"><joint name="b" axis="0 1 0"/>'
        '<inertial pos="0 0.02 -0.1" quat="0.9 0.1 0.3 0.2" mass="0.4" diaginertia="2e-3 2e-3 3e-4"/></body>'
        '<body name="C" pos="-0.03 0.08 0"><joint name="c" axis="0 0 1"/>'
        '<inertial pos="0 0.02 -0.1" mass="0.3" diaginertia="2e-3 2e-3 3e-4"/></body>'
        "</body></worldbody></mujoco>"
    )
    links, gravity_m_s2, fixed = links_of(path, ["a", "b", "c"])
    assert [link.parent for link in links] == ["base", "a", "a"] and not fixed
    assert (links[0].rotor_inertia_kg_m2, links[0].viscous_nm_s_rad) == pytest.approx((0.002, 0.1))
    text = with_links(robot_file(["a", "b", "c"]), links, gravity_m_s2)
    theirs = pin.buildModelFromMJCF(str(path))
    theirs.armature = np.zeros(3)  # of the motors: not in `built`
    assert worst(pin, built(pin, text), theirs) < 1e-7
    nameless = tmp_path / "nameless.xml"
    nameless.write_text(re.sub(r'<body name="[BC]"', "<body", path.read_text()))
    with pytest.raises(LitheError, match=r"takes joint b of .* twice\n  next: give each <body> a name of its own"):
        links_of(nameless, ["a", "b", "c"])


def test_what_the_guard_has_no_model_of_is_refused(pin: Any, arm: Path, tmp_path: Path) -> None:
    with pytest.raises(LitheError, match=r"has no joint elbow; it has j1, j2, .*grip\n  next: give the joints"):
        links_of(arm, ["j1", "elbow"])
    with pytest.raises(LitheError, match="joint grip of .* is a P[A-Z]+, and the guard's model is of hinges"):
        links_of(arm, [*NAMES, "grip"])
    with pytest.raises(LitheError, match=r"joint j2 hangs on j3|joint j3 hangs on j2, which comes later"):
        links_of(arm, ["j1", "j3", "j2"])
    links, gravity_m_s2, _ = links_of(arm, NAMES)
    once = with_links(robot_file(NAMES), links, gravity_m_s2)
    with pytest.raises(LitheError, match="the robot file has a model"):
        with_links(once, links, gravity_m_s2)
    inline = 'name = "a"\njoint = [' + ", ".join(f'{{name = "{name}"}}' for name in NAMES) + "]\n"
    with pytest.raises(LitheError, match="a form that cannot be changed here"):
        with_links(inline, links, gravity_m_s2)


def test_bad_input_is_named_and_nothing_is_written(pin: Any, arm: Path, tmp_path: Path, capsys: Any) -> None:
    robot, out = tmp_path / "robot.toml", tmp_path / "out.toml"
    robot.write_text(robot_file(NAMES))
    out.write_text("mine")
    assert main([str(robot), str(arm), "--write", str(out)]) == 2
    assert "is there already, and stays as it is" in capsys.readouterr().err and out.read_text() == "mine"
    assert main([str(robot), str(tmp_path / "none.urdf")]) == 2
    assert "Pinocchio cannot read" in capsys.readouterr().err
    assert main([str(tmp_path / "none.toml"), str(arm)]) == 2
    assert "next: give a robot file" in capsys.readouterr().err
    assert main([str(robot), str(arm)]) == 0
    told = tomllib.loads(capsys.readouterr().out.replace("[joint.model]", "[[joint]]"))
    assert len(told["joint"]) == 6 and told["model"]["gravity_m_s2"] == [0, 0, -9.81]
