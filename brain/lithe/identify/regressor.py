# SPDX-License-Identifier: Apache-2.0
"""The momentum of a planar chain, linear in its parameters.

Angles theta_i of the links from straight down are sums of the joint angles q_1 .. q_i, L_i is the length of link i.
With the angular velocity w_i of link i the energies are (Lagrange; as in Siciliano et al., Robotics, 2009, 7.2)

    T = 1/2 sum_i C_i w_i^2 + sum_{i<j} L_i mu_j cos(theta_i - theta_j) w_i w_j + 1/2 sum_k R_k (dq_k/dt)^2
    V = -g sum_i mu_i cos theta_i

    C_i  = inertia of link i about its joint + L_i^2 times all mass farther out           [kg m^2]
    mu_i = mass of link i times the way to its centre + L_i times all mass farther out    [kg m]
    R_k  = rotor of joint k, behind its gear [kg m^2]; that of the first joint cannot be told from C_1 and is part of it

The momentum p_k of joint k changes by its torque, without friction, and by dT/dq_k - dV/dq_k. Integrated over a window
from a to b, this needs no acceleration:

    [p_k] - integral of (dT/dq_k - dV/dq_k) dt + friction_k = integral of tau_k dt
    friction_k = b_k [q_k] + c_k * integral of sgn q_k' dt + s_k * integral of exp(-(q_k'/v_s)^2) sgn q_k' dt
                 + integral of (x_k cos n q_k + y_k sin n q_k) dt

with viscous b, Coulomb c, Stribeck s (v_s is given) and cogging x, y (n periods in a turn are given).

A torque that acts d_k before it is reported (drive, bus, half a tick of the hold) is, to first order, the reported one
and d_k times its change, so that the delay is one more parameter:  - d_k [tau_k].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .joint import LONGEST_GAP_S, OVERLAP, Vector, running_integral

Matrix = npt.NDArray[np.float64]
NEAR = 9  # samples


@dataclass(frozen=True)
class Description:
    """What is known of a chain before anything is measured; one entry a joint, from the base outwards."""

    names: tuple[str, ...]
    length_m: tuple[float, ...]  # from its joint to the next; that of the last link is not used
    gravity_m_s2: float = 9.81
    stribeck_rad_s: float = 0.0  # 0: no Stribeck friction is fitted
    cogging_per_turn: float = 0.0  # periods in a turn of the joint; 0: no cogging is fitted

    def rigid_names(self) -> list[tuple[str, str, str]]:
        """Of each column of `rigid`: joint, parameter, unit."""
        found = [(name, "inertia", "kg m2") for name in self.names] + [(name, "moment", "kg m") for name in self.names]
        return found + [(name, "rotor", "kg m2") for name in self.names[1:]]

    def rigid(self, q: Matrix, v: Matrix) -> tuple[Matrix, Matrix]:
        """Of each sample and each of C, mu, R: momentum of each joint, and dT/dq - dV/dq -> (n, parameters, joints)."""
        theta, w = np.cumsum(q, axis=1), np.cumsum(v, axis=1)
        n, joints = q.shape
        momentum, pull = np.zeros((n, 3 * joints - 1, joints)), np.zeros((n, 3 * joints - 1, joints))
        for j in range(joints):
            momentum[:, j, j] = w[:, j]
            mu = joints + j
            pull[:, mu, j] -= self.gravity_m_s2 * np.sin(theta[:, j])
            for i in range(j):
                apart, length = theta[:, i] - theta[:, j], self.length_m[i]
                turn = length * np.sin(apart) * w[:, i] * w[:, j]
                momentum[:, mu, i] += length * np.cos(apart) * w[:, j]
                momentum[:, mu, j] += length * np.cos(apart) * w[:, i]
                pull[:, mu, i] -= turn
                pull[:, mu, j] += turn
        for values in (momentum, pull):  # link angles are sums of joint angles
            values[:] = np.cumsum(values[:, :, ::-1], axis=2)[:, :, ::-1]
        for k in range(1, joints):
            momentum[:, 2 * joints + k - 1, k] = v[:, k]
        return momentum, pull


@dataclass(frozen=True)
class Rows:
    """Equations: `a` (n, parameters), `y` (n,) [N m s]; of each its joint, its window, counted in order of time, and
    its first and last sample. The samples: t (samples,) [s]; q, v (samples, joints).
    """

    a: Matrix
    y: Vector
    joint: npt.NDArray[np.int64]
    window: npt.NDArray[np.int64]
    first: npt.NDArray[np.int64]
    last: npt.NDArray[np.int64]
    t: Vector
    q: Matrix
    v: Matrix

    def integral(self, values: Matrix) -> Matrix:
        """Of each equation the integral over its window. values: (samples, rows of anything)."""
        whole = np.apply_along_axis(running_integral, 0, values, self.t)
        return np.asarray(whole[self.last] - whole[self.first])


def joined(parts: Sequence[Rows]) -> Rows:
    """The equations of several motions as those of one."""
    samples = np.cumsum([0, *(len(each.t) for each in parts)])
    windows = np.cumsum([0, *(int(each.window.max(initial=-1)) + 1 for each in parts)])

    def put(name: str, after: Vector | None = None) -> Any:
        return np.concatenate(
            [getattr(each, name) + (0 if after is None else after[i]) for i, each in enumerate(parts)]
        )

    return Rows(put("a"), put("y"), put("joint"), put("window", windows), put("first", samples), put("last", samples),
                put("t"), put("q"), put("v"))  # fmt: skip


def names_of(chain: Description) -> list[tuple[str, str, str]]:
    """Of each column: joint, parameter, unit."""
    joints = chain.names
    found = chain.rigid_names()
    found += [(name, "viscous", "N m s/rad") for name in joints] + [(name, "coulomb", "N m") for name in joints]
    found += [(name, "delay", "s") for name in joints]
    if chain.stribeck_rad_s > 0:
        found += [(name, "stribeck", "N m") for name in joints]
    if chain.cogging_per_turn > 0:
        found += [(name, which, "N m") for which in ("cogging_cos", "cogging_sin") for name in joints]
    return found


def _friction(chain: Description, q: Matrix, v: Matrix, t: Vector, torque: Matrix) -> tuple[Matrix, ...]:
    """What a joint's own parameters are multiplied with, since the start (n, joints): [q], sgn, delay, others."""
    sign = np.sign(v)
    inside = []
    if chain.stribeck_rad_s > 0:
        inside.append(sign * np.exp(-((v / chain.stribeck_rad_s) ** 2)))
    if chain.cogging_per_turn > 0:
        inside += [np.cos(chain.cogging_per_turn * q), np.sin(chain.cogging_per_turn * q)]

    def integral(values: Matrix) -> Matrix:
        return np.stack([running_integral(values[:, k], t) for k in range(q.shape[1])], axis=1)

    # Of the torque's mean nearby: its noise would make the delay look shorter.
    smooth = np.stack(
        [np.convolve(torque[:, k], np.full(NEAR, 1 / NEAR), mode="same") for k in range(q.shape[1])], axis=1
    )
    return (q, integral(sign), -smooth, *(integral(each) for each in inside))


def rows_of(
    chain: Description, t: Vector, q: Matrix, v: Matrix, torque: Matrix, window_s: float, moving_rad_s: float
) -> Rows:
    """The equations of one motion. t (n,) [s]; q, v, torque (n, joints); v may be NaN where nothing is known of it.

    An equation of a joint is left out where the joint nearly rests or turns back: its friction has no known sign there.
    """
    joints = q.shape[1]
    known = np.where(np.isfinite(v), v, 0.0)
    momentum, pull = chain.rigid(q, known)
    rigid = momentum.shape[1]
    steps = np.diff(t)[:, None, None]
    pulled = np.concatenate((np.zeros((1, rigid, joints)), np.cumsum((pull[1:] + pull[:-1]) / 2 * steps, axis=0)))
    friction = _friction(chain, q, known, t, torque)
    impulse = np.stack([running_integral(torque[:, k], t) for k in range(joints)], axis=1)
    start_s = np.arange(t[0], t[-1] - window_s, window_s / OVERLAP)
    first, last = np.searchsorted(t, start_s), np.searchsorted(t, start_s + window_s)

    def anywhere(what: npt.ArrayLike, end: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        """Of each window, whether it is so from its first sample on and before `end`."""
        so_far = np.cumsum(what, axis=0)
        count = np.concatenate((np.zeros_like(so_far[:1]), so_far))
        return np.asarray(count[end] - count[first] > 0)

    gap = anywhere(np.diff(t) > LONGEST_GAP_S, last)
    usable = (first < last) & ~gap & ~anywhere(~np.isfinite(v).all(axis=1), last + 1)
    moves = ~anywhere(known <= moving_rad_s, last + 1) | ~anywhere(known >= -moving_rad_s, last + 1)
    window, joint = np.nonzero(usable[:, None] & moves)
    a = np.zeros((len(window), rigid + len(friction) * joints))
    change = momentum[last] - momentum[first] - (pulled[last] - pulled[first])
    a[:, :rigid] = change[window, :, joint]
    for which, integral in enumerate(friction):
        a[np.arange(len(window)), rigid + which * joints + joint] = (integral[last] - integral[first])[window, joint]
    y = (impulse[last] - impulse[first])[window, joint]
    return Rows(a, y, joint, window, first[window], last[window], t, q, known)
