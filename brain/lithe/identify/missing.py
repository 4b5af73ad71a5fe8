# SPDX-License-Identifier: Apache-2.0
"""Whether a term that was not fitted would explain what a fit has left: Stribeck friction (one with another speed than
was given is seldom noticed), and torques that repeat in a turn (cogging, a gear).

A term is named where chance would explain such a share of the residual in one of 100,000 robots (as with normal noise
that is new in each window that does not overlap), and where it matters beside the joint's torque.
"""

from __future__ import annotations

import numpy as np

from .joint import OVERLAP, Vector
from .regressor import Description, Matrix, Rows

SPEEDS_RAD_S = (0.05, 0.1, 0.2, 0.4, 0.8)
PERIODS = range(2, 101, 2)  # in a turn; a motion of half a turn tells those apart that differ by two
CHANCE = 1e-5
MATTERS = 0.003  # of the joint's torque, root of the mean square
HELD = 3.0  # a residual counts as no more than so many times the usual one


def _without(basis: Matrix, columns: Matrix) -> Matrix:
    return np.asarray(columns - basis @ (basis.T @ columns))


def left_out(chain: Description, rows: Rows, value: Vector) -> list[str]:
    """For each joint the term that explains most of what `value` leaves, if it is more than chance; what to do."""
    said = []
    for k, name in enumerate(chain.names):
        of = rows.joint == k
        a, here = rows.a[of], np.flatnonzero(of)
        if len(here) < 2 * OVERLAP * (np.count_nonzero(a.any(axis=0)) // OVERLAP + 3):
            continue
        left = rows.y[of] - a @ value
        usual = 1.4826 * float(np.median(np.abs(left)))
        basis = np.linalg.qr(a[:, a.any(axis=0)])[0]
        left = _without(basis, np.clip(left, -HELD * usual, HELD * usual))
        matters = MATTERS**2 * float(rows.y[of] @ rows.y[of])
        if left @ left <= matters:
            continue
        q, v = rows.q[:, k], rows.v[:, k]
        terms: dict[str, Matrix] = {
            f"friction that falls with the speed: stribeck_nm with stribeck_rad_s = {speed:g}":
            (np.sign(v) * np.exp(-((v / speed) ** 2)))[:, None] for speed in SPEEDS_RAD_S
        }  # fmt: skip
        for n in PERIODS:
            terms[f"a torque that repeats about {n} times in a turn: cogging_nm with cogging_per_rev = {n}"] = np.stack(
                (np.cos(n * q), np.sin(n * q)), axis=1)  # fmt: skip
        windows = len(left) / OVERLAP - basis.shape[1] / OVERLAP
        best, term = 0.0, ""
        for words, values in terms.items():
            column = rows.integral(values)[here]
            extra = np.linalg.qr(_without(basis, column))[0]
            share = float(np.sum((extra.T @ left) ** 2) / (left @ left))
            if share > best:
                best, term = share, words
        kind = len(SPEEDS_RAD_S) if "speed" in term else len(PERIODS)  # so many were tried
        by_chance = kind * (1 - best) ** (windows / 2)
        if by_chance < CHANCE and best * float(left @ left) > matters:
            said.append(f"{name}: {best:.0%} of what is left unexplained looks like {term} in the robot file")
    return said
