# SPDX-License-Identifier: Apache-2.0
"""Planar chains in plain Python, many at once, that follow a reference under a PD.

A plant for tests of `lithe.identify`: written from the links' positions (mass matrix by Jacobians), and not from the
regressor's equations, so that both must be right. Shapes: (robots, joints).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt
from lithe.identify import Description, Motion

Vector = npt.NDArray[np.float64]
STEP_S = 0.001
GRAVITY = 9.81
REST_RAD_S = 0.02  # below this speed dry friction fades, so that the integration stays stable
STRIBECK_RAD_S = 0.3
COGGING_PER_TURN = 14.0
ENCODER_RAD = 2 * np.pi / 65536


@dataclass
class Chains:
    """Robots with as many links each; friction per joint."""

    length_m: Vector
    mass_kg: Vector
    centre_m: Vector
    inertia_kg_m2: Vector  # about the centre of mass
    rotor_kg_m2: Vector
    viscous_nm_s_rad: Vector
    coulomb_nm: Vector
    stribeck_nm: Vector
    cogging_cos_nm: Vector
    cogging_sin_nm: Vector

    @classmethod
    def drawn(cls, robots: int, joints: int, seed: int) -> Chains:
        """Links of 0.1 to 0.3 m and 0.1 to 0.4 kg."""
        rng = np.random.default_rng(seed)

        def between(low: float, high: float) -> Vector:
            return rng.uniform(low, high, (robots, joints))

        length, mass = between(0.1, 0.3), between(0.1, 0.4)
        return cls(
            length, mass, length * between(0.4, 0.7), mass * length**2 * between(0.06, 0.12), between(1e-3, 3e-3),
            between(0.01, 0.04), between(0.01, 0.05), *np.zeros((3, robots, joints)),
        )  # fmt: skip

    @classmethod
    def together(cls, those: Sequence[Chains]) -> Chains:
        """All of them, to be simulated at once."""
        return cls(*(np.concatenate([getattr(one, each.name) for one in those]) for each in fields(cls)))

    def description(self, robot: int) -> Description:
        """What is known of one of them."""
        joints = self.length_m.shape[1]
        stribeck_rad_s = STRIBECK_RAD_S if self.stribeck_nm[robot].any() else 0.0
        cogging = COGGING_PER_TURN if self.cogging_cos_nm[robot].any() else 0.0
        names = tuple(f"joint{k}" for k in range(joints))
        return Description(names, tuple(self.length_m[robot]), GRAVITY, stribeck_rad_s, cogging)

    def truth(self, robot: int) -> dict[tuple[str, str], float]:
        """The parameters of the regressor (its docstring defines them)."""
        length, mass = self.length_m[robot], self.mass_kg[robot]
        joints = len(mass)
        found: dict[tuple[str, str], float] = {}
        for k in range(joints):
            beyond = float(mass[k + 1 :].sum())
            name = f"joint{k}"
            own = self.inertia_kg_m2[robot, k] + mass[k] * self.centre_m[robot, k] ** 2
            found[name, "inertia"] = own + beyond * length[k] ** 2 + (self.rotor_kg_m2[robot, 0] if k == 0 else 0.0)
            found[name, "moment"] = mass[k] * self.centre_m[robot, k] + beyond * length[k]
            if k > 0:
                found[name, "rotor"] = self.rotor_kg_m2[robot, k]
            found[name, "viscous"] = self.viscous_nm_s_rad[robot, k]
            found[name, "coulomb"] = self.coulomb_nm[robot, k]
            if self.description(robot).stribeck_rad_s:
                found[name, "stribeck"] = self.stribeck_nm[robot, k]
            if self.description(robot).cogging_per_turn:
                found[name, "cogging_cos"] = self.cogging_cos_nm[robot, k]
                found[name, "cogging_sin"] = self.cogging_sin_nm[robot, k]
            found[name, "delay"] = STEP_S / 2  # a tick tells the torque that it held until now
        return found

    def _reach_m(self) -> Vector:
        """(robots, links, joints): the way to the centre of mass of each link is the sum of these along the links."""
        inner = np.tri(self.length_m.shape[1], k=-1)
        return np.asarray(inner * self.length_m[:, None, :] + np.eye(len(inner)) * self.centre_m[:, None, :])

    def acceleration(self) -> Callable[[Vector, Vector, Vector], Vector]:
        """Of the joints, from q, v and torque. Each centre of mass is a sum of links; its Jacobian gives mass matrix
        and velocity terms.
        """
        reach, mass = self._reach_m(), self.mass_kg
        joints = mass.shape[1]
        below = np.tri(joints)  # theta = below q
        of_links = np.eye(joints) * self.inertia_kg_m2[:, None, :]
        own = below.T @ of_links @ below + np.eye(joints) * self.rotor_kg_m2[:, None, :]
        doubled = np.concatenate((mass, mass), axis=1)

        def found(q: Vector, v: Vector, torque: Vector) -> Vector:
            theta, w = q @ below.T, v @ below.T
            across, along = reach * np.cos(theta)[:, None, :], reach * np.sin(theta)[:, None, :]
            jacobian = np.concatenate((across, along), axis=1)  # x = sum r sin theta, y = -sum r cos theta
            turning = np.concatenate((-along, across), axis=1) @ (w**2)[..., None]  # acceleration where w stays
            turning[:, joints:] += GRAVITY
            pushed = (doubled[..., None] * jacobian).swapaxes(1, 2)
            load = torque - self.viscous_nm_s_rad * v - self.dry_nm(q, v) - (pushed @ turning)[..., 0] @ below
            in_joints = below.T @ (pushed @ jacobian) @ below + own
            return np.asarray(np.linalg.solve(in_joints, load[..., None])[..., 0])

        return found

    def dry_nm(self, q: Vector, v: Vector) -> Vector:
        """Friction that is there at any speed, and fades near rest only; and cogging."""
        dry = self.coulomb_nm + self.stribeck_nm * np.exp(-((v / STRIBECK_RAD_S) ** 2))
        turn = COGGING_PER_TURN * q
        cogging = self.cogging_cos_nm * np.cos(turn) + self.cogging_sin_nm * np.sin(turn)
        return np.asarray(dry * np.tanh(v / REST_RAD_S) + cogging)

    def follow(self, wanted_rad: Vector, torque_noise_nm: Vector | float = 0.01, seed: int = 0) -> list[list[Motion]]:
        """Telemetry of each robot, one Motion per joint.

        `wanted_rad`: of each tick (n, joints), or (n, robots, joints). `torque_noise_nm` may be (robots, 1).
        """
        rng = np.random.default_rng(seed)
        t: Vector = np.arange(len(wanted_rad)) * STEP_S
        wanted = np.broadcast_to(wanted_rad if wanted_rad.ndim == 3 else wanted_rad[:, None, :],
                                 (len(t), *self.mass_kg.shape))  # fmt: skip
        q, v = wanted[0].copy(), np.zeros_like(self.mass_kg)
        angles, torques = np.zeros(wanted.shape), np.zeros(wanted.shape)
        acceleration, h = self.acceleration(), STEP_S
        for n in range(len(t)):
            torque = 30.0 * (wanted[n] - q) - 0.4 * v
            angles[n], torques[n] = q, torque
            a = acceleration(q, v, torque)  # the usual method of Runge and Kutta
            b = acceleration(q + h / 2 * v, v + h / 2 * a, torque)
            c = acceleration(q + h / 2 * v + h * h / 4 * a, v + h / 2 * b, torque)
            d = acceleration(q + h * v + h * h / 2 * b, v + h * c, torque)
            q, v = q + h * v + h * h / 6 * (a + b + c), v + h / 6 * (a + 2 * b + 2 * c + d)
        # What a drive reports at a tick is the torque until then.
        torques = np.concatenate((torques[:1], torques[:-1]))
        torques += torque_noise_nm * rng.standard_normal(torques.shape)
        angles = np.floor(angles / ENCODER_RAD) * ENCODER_RAD
        nothing = np.zeros(len(t))
        return [
            [Motion(t, angles[:, robot, k], nothing, torques[:, robot, k]) for k in range(q.shape[1])]
            for robot in range(q.shape[0])
        ]


def as_recorded(motion: Sequence[Motion]) -> npt.NDArray[Any]:
    """Telemetry as the flight recorder has it, of a Motion per joint."""
    names = ("position_rad", "velocity_rad_s", "torque_nm")
    layout = [("sample_ns", "i8"), *((name, "f8", len(motion)) for name in names)]
    records = np.zeros(len(motion[0].t_s), layout)
    records["sample_ns"] = np.round(1e9 * motion[0].t_s)
    for name in names:
        records[name] = np.stack([getattr(joint, name) for joint in motion], axis=1)
    return records
