# SPDX-License-Identifier: Apache-2.0
"""A robot of a model file (URDF, or MuJoCo's MJCF) for `identify_chain`: any tree of links, by Pinocchio
(`pip install pin`; computeJointTorqueRegressor).

The torque is linear in ten parameters of each link, tau = Y(q, v, a) p: mass, moment (mass times centre) and inertia in
the frame of its joint. By dp/dt - pull = tau (`regressor`) the momentum is Y(q, 0, v) p without gravity, and the pull
is its change along q at constant v, here a quotient of differences, less Y(q, v, 0) p.

A motion tells sums of parameters only. A column that is a sum of columns before it is left out, and its parameter goes
into theirs (base parameters; Gautier, Journal of Robotic Systems 8, 1991). So `mass` may stay 0 where all of it is
found as moments and inertias of the links before it.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import LitheError
from .regressor import Description, Matrix

OF_A_LINK = (("mass", "kg"), *((f"moment_{axis}", "kg m") for axis in "xyz"),
             *((f"inertia_{axes}", "kg m2") for axes in ("xx", "xy", "yy", "xz", "yz", "zz")))  # fmt: skip
STEP = 1e-5  # of the quotient of differences: as much is lost by rounding as by its second order, some 1e-10
PLACES = 40  # drawn at random, to see which columns depend on others
DEPENDS = 1e-6  # of a column's length, left when all columns before it have explained what they can


def pinocchio() -> Any:
    """The package. LitheError where it is not installed."""
    try:
        import pinocchio
    except ImportError:
        raise LitheError("a model needs Pinocchio\n  next: pip install pin") from None
    return pinocchio


@dataclass(frozen=True)
class Model(Description):
    """A robot of a model file. Joints as they are named here, and in this order."""

    robot: Any = None  # pinocchio.Model
    kept: tuple[int, ...] = ()  # columns that depend on none before them
    file_values: tuple[float, ...] = ()  # of these, in the file

    def rigid_names(self) -> list[tuple[str, str, str]]:
        """Of each column of `rigid`: joint (that moves the link), parameter, unit."""
        every = [(name, *of) for name in list(self.robot.names)[1:] for of in OF_A_LINK]
        every += [(name, "rotor", "kg m2") for name in self.names]
        return [every[k] for k in self.kept]

    def rigid(self, q: Matrix, v: Matrix) -> tuple[Matrix, Matrix]:
        """Of each sample and each column: momentum of each joint, and its pull -> (n, parameters, joints)."""
        pin = pinocchio()
        robot, weightless, data = self.robot, self.robot.copy(), self.robot.createData()
        weightless.gravity = pin.Motion.Zero()
        order = [robot.joints[robot.getJointId(name)].idx_v for name in self.names]
        n, joints = q.shape
        rigid, still, start = len(OF_A_LINK) * joints, np.zeros(joints), pin.neutral(robot)
        momentum, pull = np.zeros((n, rigid + joints, joints)), np.zeros((n, rigid + joints, joints))
        turned, fast = np.zeros_like(q), np.zeros_like(v)
        turned[:, order], fast[:, order] = q, v
        for i in range(n):
            w = fast[i]

            def momenta(at: Matrix, w: Matrix = w) -> Matrix:
                return np.array(
                    pin.computeJointTorqueRegressor(weightless, data, pin.integrate(robot, start, at), still, w)
                )

            ahead, behind = momenta(turned[i] + STEP * w), momenta(turned[i] - STEP * w)
            at = pin.integrate(robot, start, turned[i])
            force = np.array(pin.computeJointTorqueRegressor(robot, data, at, w, still))
            momentum[i, :rigid] = momenta(turned[i])[order].T
            pull[i, :rigid] = ((ahead - behind) / (2 * STEP) - force)[order].T
        for k in range(joints):
            momentum[:, rigid + k, k] = v[:, k]
        return (momentum[:, self.kept], pull[:, self.kept]) if self.kept else (momentum, pull)


def _independent(columns: Matrix) -> tuple[int, ...]:
    """Those that are no sum of columns before them."""
    basis = np.zeros((len(columns), 0))
    kept = []
    for k, column in enumerate(columns.T):
        left = column
        for _ in range(2):  # the second time takes what rounding left
            left = left - basis @ (basis.T @ left)
        if np.linalg.norm(left) > DEPENDS * max(float(np.linalg.norm(column)), DEPENDS):
            basis = np.column_stack((basis, left / np.linalg.norm(left)))
            kept.append(k)
    return tuple(kept)


def read_model(path: str | Path) -> Any:
    """pinocchio.Model of a .urdf file, or of MJCF. LitheError where Pinocchio cannot read it."""
    pin = pinocchio()
    build = pin.buildModelFromUrdf if Path(path).suffix == ".urdf" else pin.buildModelFromMJCF
    try:
        robot = build(str(path))
    except Exception as error:  # Pinocchio lets through what its readers throw, IndexError and others
        raise LitheError(
            f"Pinocchio cannot read {path}: {type(error).__name__}: {error}\n"
            "  next: correct the file (it wants at most one unnamed <default>), or give a URDF"
        ) from None
    if twice := [name for name, count in Counter(robot.names).items() if count > 1]:  # of two bodies without a name
        raise LitheError(
            f"Pinocchio takes joint {twice[0]} of {path} twice\n  next: give each <body> a name of its own"
        )
    return robot


def describe_model(
    path: str | Path, names: tuple[str, ...] = (), stribeck_rad_s: float = 0.0, cogging_per_turn: float = 0.0
) -> Model:
    """The robot of a .urdf file, or of MJCF. `names`: its joints in the order of the telemetry (default: the file's).

    LitheError where Pinocchio is missing or cannot read the file, or where the joints that move are others. The weight
    and size of the links in the file are not used but for `file_values`; its joints, lengths and gravity are.
    """
    robot = read_model(path)
    moving = list(robot.names)[1:]
    if robot.nv != len(moving) or sorted(names or moving) != sorted(moving):
        raise LitheError(
            f"the joints of {path} are {', '.join(moving)}, those of the robot {', '.join(names)}\n"
            "  next: one hinge or slide of its name for each joint of the robot, and no others"
        )
    every = Model(names or tuple(moving), (), float(np.linalg.norm(robot.gravity.linear)), stribeck_rad_s,
                  cogging_per_turn, robot)  # fmt: skip
    dice = np.random.default_rng(0)
    seen = np.concatenate(every.rigid(*dice.uniform(-2, 2, (2, PLACES, robot.nv))))
    columns: Matrix = seen.swapaxes(1, 2).reshape(-1, seen.shape[1])
    kept = _independent(columns)
    order = [robot.joints[robot.getJointId(name)].idx_v for name in every.names]
    rotor = np.asarray(robot.armature + robot.rotorInertia * robot.rotorGearRatio**2)[order]
    full = np.concatenate([*(robot.inertias[k + 1].toDynamicParameters() for k in range(robot.nv)), rotor])
    values = np.linalg.lstsq(columns[:, kept], columns @ full, rcond=None)[0]
    return replace(every, kept=kept, file_values=tuple(map(float, values)))
