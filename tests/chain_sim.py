# SPDX-License-Identifier: Apache-2.0
"""Planar chains in plain Python, many at once, that follow a reference under a PD.

A plant for tests of `lithe.identify`: written from the links' positions (mass matrix by Jacobians), and not from the
regressor's equations, so that both must be right. Shapes: (robots, joints).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from lithe.identify import Description, Motion

Vector = npt.NDArray[np.float64]
STEP_S = 0.001
GRAVITY = 9.81
REST_RAD_S = 0.02  # below this speed dry friction fades, so that the integration stays stable
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

    @classmethod
    def drawn(cls, robots: int, joints: int, seed: int) -> Chains:
        """Links of 0.1 to 0.3 m and 0.1 to 0.4 kg."""
        rng = np.random.default_rng(seed)

        def between(low: float, high: float) -> Vector:
            return rng.uniform(low, high, (robots, joints))

        length, mass = between(0.1, 0.3), between(0.1, 0.4)
        return cls(
            length, mass, length * between(0.4, 0.7), mass * length**2 * between(0.06, 0.12), between(1e-3, 3e-3),
            between(0.01, 0.04), between(0.01, 0.05),
        )  # fmt: skip

    def description(self, robot: int) -> Description:
        """What is known of one of them."""
        joints = self.length_m.shape[1]
        return Description(tuple(f"joint{k}" for k in range(joints)), tuple(self.length_m[robot]), GRAVITY)

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
            found[name, "delay"] = STEP_S / 2  # a tick tells the torque that it held until now
        return found

    def acceleration(self, q: Vector, v: Vector, torque: Vector) -> Vector:
        """Of the joints. Each centre of mass is a sum of links; its Jacobian gives mass matrix and velocity terms."""
        robots, joints = q.shape
        theta, w = np.cumsum(q, axis=1), np.cumsum(v, axis=1)
        sine, cosine = np.sin(theta), np.cos(theta)
        matrix = np.zeros((robots, joints, joints))
        force = np.zeros((robots, joints))  # of the links, by their angles
        for link in range(joints):
            reach = np.where(np.arange(joints) < link, self.length_m, 0.0)
            reach[:, link] = self.centre_m[:, link]
            jx, jy = reach * cosine, reach * sine  # x = sum r sin theta, y = -sum r cos theta
            mass = self.mass_kg[:, link]
            matrix += mass[:, None, None] * (jx[:, :, None] * jx[:, None, :] + jy[:, :, None] * jy[:, None, :])
            ax = -np.sum(reach * sine * w**2, axis=1)
            ay = np.sum(reach * cosine * w**2, axis=1) + GRAVITY
            force -= mass[:, None] * (jx * ax[:, None] + jy * ay[:, None])
            matrix[:, link, link] += self.inertia_kg_m2[:, link]
        below = np.tril(np.ones((joints, joints)))  # theta = below q
        in_joints = below.T @ matrix @ below
        in_joints[:, range(joints), range(joints)] += self.rotor_kg_m2
        load = torque - self.viscous_nm_s_rad * v - self.coulomb_nm * np.tanh(v / REST_RAD_S) + force @ below
        return np.asarray(np.linalg.solve(in_joints, load[..., None])[..., 0])

    def follow(
        self, curve: Callable[[Vector], Vector], seconds: float, torque_noise_nm: float = 0.01, seed: int = 0
    ) -> list[list[Motion]]:
        """Telemetry of each robot, one Motion per joint; curve: times [s] (n,) -> angles [rad] (n, joints)."""
        rng = np.random.default_rng(seed)
        t: Vector = np.arange(round(seconds / STEP_S)) * STEP_S
        wanted = curve(t)
        q = np.repeat(wanted[:1], len(self.mass_kg), axis=0)
        v = np.zeros_like(q)
        angles, torques = np.zeros((len(t), *q.shape)), np.zeros((len(t), *q.shape))
        for n in range(len(t)):
            torque = 30.0 * (wanted[n] - q) - 0.4 * v
            angles[n], torques[n] = q, torque

            def slope(q: Vector, v: Vector, torque: Vector = torque) -> tuple[Vector, Vector]:
                return v, self.acceleration(q, v, torque)

            a = slope(q, v)
            b = slope(q + STEP_S / 2 * a[0], v + STEP_S / 2 * a[1])
            c = slope(q + STEP_S / 2 * b[0], v + STEP_S / 2 * b[1])
            d = slope(q + STEP_S * c[0], v + STEP_S * c[1])
            q, v = (x + STEP_S / 6 * (a[i] + 2 * b[i] + 2 * c[i] + d[i]) for i, x in enumerate((q, v)))
        # What a drive reports at a tick is the torque until then.
        torques = np.concatenate((torques[:1], torques[:-1]))
        torques += torque_noise_nm * rng.standard_normal(torques.shape)
        angles = np.floor(angles / ENCODER_RAD) * ENCODER_RAD
        nothing = np.zeros(len(t))
        return [
            [Motion(t, angles[:, robot, k], nothing, torques[:, robot, k]) for k in range(q.shape[1])]
            for robot in range(q.shape[0])
        ]
