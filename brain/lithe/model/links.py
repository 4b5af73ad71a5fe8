# SPDX-License-Identifier: Apache-2.0
"""Links of a URDF or MJCF file as `[model]` and `[joint.model]` of a robot file (docs/hardware.md)."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import LitheError
from ..identify.model import pinocchio, read_model

Vector = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Link:
    """What one joint moves. Vectors in the link's axes, but for `offset_m` and `rest_rad`: in those of the parent."""

    joint: str
    parent: str  # "base" where no joint carries it
    axis: Vector  # (3,), unit
    offset_m: Vector  # (3,)
    rest_rad: Vector  # (3,) roll, pitch, yaw: turns about the parent's fixed x, y, z in this order, as in a URDF
    mass_kg: float
    center_m: Vector  # (3,)
    inertia_kg_m2: Vector  # (6,) about the centre: xx, yy, zz, xy, xz, yz
    rotor_inertia_kg_m2: float  # behind its gear
    viscous_nm_s_rad: float


def links_of(path: str | Path, names: Sequence[str]) -> tuple[list[Link], Vector, list[str]]:
    """Of each of the robot's joints its link; gravity (3,) in m/s2; joints of the file that the robot does not have.

    These are taken as fixed where the file has its angle 0. LitheError where the file cannot be read, lacks a joint of
    the robot, or where one is no hinge on a fixed base or hangs on a later joint.
    """
    pin = pinocchio()
    whole = read_model(path)
    moving = list(whole.names)[1:]
    if missing := [name for name in names if name not in moving]:
        raise LitheError(
            f"{path} has no joint {', '.join(missing)}; it has {', '.join(moving)}\n"
            "  next: give the joints the same names in both files"
        )
    fixed = [name for name in moving if name not in names]
    robot = pin.buildReducedModel(whole, [whole.getJointId(name) for name in fixed], pin.neutral(whole))
    links = [_link(path, robot, name) for name in names]
    order = {name: k for k, name in enumerate(names)}
    for link in links:
        if link.parent != "base" and order[link.parent] > order[link.joint]:
            raise LitheError(
                f"joint {link.joint} hangs on {link.parent}, which comes later in the robot file\n"
                f"  next: move the [[joint]] of {link.parent} before it"
            )
    return links, np.array(robot.gravity.linear), fixed


def _link(path: str | Path, robot: Any, name: str) -> Link:
    pin = pinocchio()
    k = robot.getJointId(name)
    joint, place, body = robot.joints[k], robot.jointPlacements[k], robot.inertias[k]
    axis = np.ravel(joint.createData().S) if joint.nv == 1 else np.zeros(6)
    if not np.isclose(np.linalg.norm(axis[3:]), 1) or np.linalg.norm(axis[:3]) > 0:
        raise LitheError(
            f"joint {name} of {path} is a {joint.shortname().removeprefix('JointModel')}, and the guard's model is of "
            "hinges on a fixed base\n  next: leave [model] out of this robot's file"
        )
    inertia = np.array(body.inertia)
    return Link(
        name,
        robot.names[robot.parents[k]] if robot.parents[k] else "base",
        axis[3:],
        np.array(place.translation),
        np.array(pin.rpy.matrixToRpy(place.rotation)),
        float(body.mass),
        np.array(body.lever),
        np.array([inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]),
        float(robot.armature[joint.idx_v] + robot.rotorInertia[joint.idx_v] * robot.rotorGearRatio[joint.idx_v] ** 2),
        float(robot.damping[joint.idx_v]),
    )


def tables(links: list[Link], gravity_m_s2: Vector) -> tuple[str, dict[str, str]]:
    """`[model]`, and of each joint its `[joint.model]`."""
    return f"[model]\ngravity_m_s2 = {_list(gravity_m_s2)}\n", {link.joint: _table(link) for link in links}


def _table(link: Link) -> str:
    lines = [f'parent = "{link.parent}"', f"mass_kg = {_text(link.mass_kg)}"]
    for key, usual in (("axis", (0, 0, 1)), ("offset_m", 0), ("rest_rad", 0), ("center_m", 0), ("inertia_kg_m2", 0)):
        vector = getattr(link, key)
        if not np.allclose(vector, usual, rtol=0, atol=1e-12):
            lines.append(f"{key} = {_list(vector)}")
    for key in ("rotor_inertia_kg_m2", "viscous_nm_s_rad"):
        if getattr(link, key):
            lines.append(f"{key} = {_text(getattr(link, key))}")
    return "[joint.model]\n" + "\n".join(lines) + "\n"


def _text(value: float) -> str:
    return f"{0.0 if abs(value) < 1e-12 else value:.9g}"


def _list(vector: Vector) -> str:
    return f"[{', '.join(map(_text, vector))}]"


def with_links(text: str, links: list[Link], gravity_m_s2: Vector) -> str:
    """The text of a robot file with this model. LitheError where it has one, or where its form is too special."""
    before = tomllib.loads(text)
    if "model" in before or any("model" in joint for joint in before["joint"]):
        raise LitheError("the robot file has a model\n  next: take its [model] and every [joint.model] out first")
    top, of_joint = tables(links, gravity_m_s2)
    lines = text.splitlines(keepends=True)
    heads = [k for k, line in enumerate(lines) if re.match(r"\s*\[", line)]
    joints = [k for k in heads if re.match(r"\s*\[\[\s*joint\s*\]\]", lines[k])]
    if len(joints) == len(before["joint"]):
        for start, joint in reversed(list(zip(joints, before["joint"], strict=True))):
            end = next((k for k in heads if k > start), len(lines))
            last = max(k for k in range(start, end) if lines[k].strip() and not lines[k].lstrip().startswith("#"))
            lines[last] = lines[last].rstrip("\n") + "\n"
            lines.insert(last + 1, of_joint[str(joint["name"])])
        lines.insert(heads[0], top + "\n")
    changed = "".join(lines)
    wanted = {**before, **tomllib.loads(top)}
    wanted["joint"] = [{**joint, **tomllib.loads(of_joint[str(joint["name"])])["joint"]} for joint in before["joint"]]
    try:
        as_meant = tomllib.loads(changed) == wanted
    except tomllib.TOMLDecodeError:
        as_meant = False
    if not as_meant:
        raise LitheError(
            "this robot file says its joints in a form that cannot be changed here\n"
            "  next: run the command without --write, and put what it prints where docs/hardware.md says"
        )
    return changed
