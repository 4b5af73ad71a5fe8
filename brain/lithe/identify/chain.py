# SPDX-License-Identifier: Apache-2.0
"""Fits the parameters of a planar chain (`regressor`), or of a robot with a model (`model`), to its motion, with
intervals and with a warning where the motion tells too little.

Robust: Huber's weights (Huber 1964), each joint's equations in units of its own residuals. The standard errors allow
for residuals that are alike in neighbouring windows and in all joints at once: they come from fits that leave out one
stretch of time after another (the jackknife; Miller, Biometrika 61, 1974).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..errors import LitheError
from ..files import read_regular, robot_table
from .joint import OVERLAP, Motion, Vector, velocity
from .missing import left_out
from .regressor import Description, Matrix, Rows, joined, names_of, rows_of

WINDOW_S = 0.16
MOVING_RAD_S = 0.15
HUBER = 1.345  # 95 % as good as least squares where the noise is normal
STRETCHES = 12
FEW = 2.201 / 1.96  # so few stretches: Student's interval with 11 degrees of freedom is that much wider
ROUNDS = 8
ENTANGLED = 100.0  # condition number of the columns, each of length 1 (Gautier and Khalil 1992)
VAGUE = 0.5  # of a value
FELT = 0.2  # of a joint's torque: what is not known of a parameter that may be 0 may do that much
MIXED = 0.3  # of the direction in which the equations tell least
BOUNDED = ("viscous", "coulomb", "stribeck")  # friction never drives


@dataclass(frozen=True)
class Parameter:
    """One estimate. `low` to `high`: its interval, with a confidence of 95 %; that of friction begins at 0 or above."""

    joint: str
    name: str
    unit: str
    value: float
    error: float  # standard error

    @property
    def low(self) -> float:
        """The least that it may be."""
        least = self.value - 1.96 * self.error
        return max(least, 0.0) if self.name in BOUNDED else least

    @property
    def high(self) -> float:
        """The most that it may be."""
        return self.value + 1.96 * self.error


@dataclass(frozen=True)
class ChainFit:
    """What a motion told. `residual_nm`: of each joint, torque that the model leaves, root of the mean square."""

    parameters: tuple[Parameter, ...]
    residual_nm: dict[str, float]
    condition: float  # of the equations, columns of length 1
    windows: int
    warnings: tuple[str, ...]
    given: dict[str, float] = field(default_factory=dict)  # what was not fitted, but taken from the description
    covariance: tuple[tuple[float, ...], ...] = ()  # of the parameters

    def __getitem__(self, key: tuple[str, str]) -> Parameter:
        """That of (joint, name)."""
        return next(each for each in self.parameters if (each.joint, each.name) == key)


@dataclass(frozen=True)
class Payload:
    """A point mass on the last link, `reach_m` from its joint, with standard errors."""

    mass_kg: float
    mass_error_kg: float
    reach_m: float
    reach_error_m: float


def describe(robot_file: str | Path) -> Description:
    """The chain of a robot file with `[plant] kind = "chain"`. LitheError where it has none."""
    try:
        config = robot_table(read_regular(robot_file))
        plant = config.get("plant", {})
        if plant.get("kind") != "chain":
            raise LitheError(
                f'{robot_file} has no [plant] kind = "chain"\n'
                "  next: joints that swing each on its own: lithe.identify.identify_joint"
            )
        sims = [(joint["name"], joint["sim"]) for joint in config["joint"]]
        return Description(
            tuple(name for name, _ in sims),
            tuple(float(sim["length_m"]) for _, sim in sims),
            float(plant.get("gravity_m_s2", 9.81)),
            max(float(sim.get("stribeck_rad_s", 0.1)) if sim.get("stribeck_nm", 0) else 0.0 for _, sim in sims),
            max(float(sim.get("cogging_per_rev", 0.0)) if sim.get("cogging_nm", 0) else 0.0 for _, sim in sims),
        )
    except (OSError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise LitheError(
            f"cannot read a chain from {robot_file}: {type(error).__name__}: {error}\n"
            f"  next: `lithe bus plan {robot_file}` names the mistakes of a robot file"
        ) from None


def _equations(chain: Description, motions: Sequence[Sequence[Motion]], window_s: float, moving_rad_s: float) -> Rows:
    found: list[Rows] = []
    for joints in motions:
        if len(joints) != len(chain.names):
            raise ValueError(f"a motion has {len(joints)} joints, the chain {len(chain.names)}: one Motion for each")
        if any(len(joint.t_s) != len(joints[0].t_s) or (joint.t_s != joints[0].t_s).any() for joint in joints):
            raise ValueError("the joints of a motion differ in their times: take all from the same records")
        whole = [joint.without_repeats() for joint in joints]
        if len(whole[0].t_s) < 2:
            continue
        columns = [
            np.stack([getattr(joint, name) for joint in whole], axis=1) for name in ("position_rad", "torque_nm")
        ]
        # The slope over 2 h is too small by the third derivative times h^2 / 10; two of them tell by how much.
        v = np.stack([(4 * velocity(joint, 0.5) - velocity(joint)) / 3 for joint in whole], axis=1)
        found.append(rows_of(chain, whole[0].t_s, columns[0], v, columns[1], window_s, moving_rad_s))
    rows = joined(found) if found else None
    if rows is None or not len(rows.y):
        raise ValueError("no window with motion: excite the chain more, or record longer")
    return rows


def _spread(residual: Vector) -> float:
    """Standard deviation of normal noise that has this median; large values count no more than small ones."""
    return max(float(1.4826 * np.median(np.abs(residual))), 1e-12)


def _solve(a: Matrix, y: Vector, joint: npt.NDArray[np.int64]) -> Vector:
    """Robust estimates. `a`: the columns that are fitted."""
    weight = np.ones(len(y))
    solution = np.zeros(a.shape[1])
    length = np.maximum(np.linalg.norm(a, axis=0), 1e-300)
    unit = a / length  # so that the normal equations lose no more digits than they must
    each = [np.flatnonzero(joint == k) for k in np.unique(joint)]
    for _ in range(ROUNDS):
        weighted = unit * weight[:, None]
        solution = np.linalg.lstsq(weighted.T @ unit, weighted.T @ y, rcond=None)[0]
        residual = y - unit @ solution
        for of in each:
            spread = _spread(residual[of])
            weight[of] = np.minimum(1.0, HUBER * spread / np.maximum(np.abs(residual[of]), 1e-300)) / spread**2
    return np.asarray(solution / length, dtype=np.float64)


def _covariance(a: Matrix, rows: Rows) -> Matrix:
    """Of the estimates: how they change when one stretch of time after another is left out."""
    edges = np.quantile(rows.window, np.arange(1, STRETCHES) / STRETCHES)
    stretch = np.searchsorted(edges, rows.window)
    without = np.array([
        _solve(a[stretch != each], rows.y[stretch != each], rows.joint[stretch != each]) for each in range(STRETCHES)
    ])  # fmt: skip
    change = without - without.mean(axis=0)
    return np.asarray(FEW**2 * (change.T @ change) * (STRETCHES - 1) / STRETCHES)


def _check_rank(a: Matrix, names: list[tuple[str, str, str]]) -> tuple[float, list[str]]:
    """The condition number, and the parameters that are told apart least.

    ValueError names those that the motion does not tell apart, or not at all.
    """
    length = np.linalg.norm(a, axis=0)
    silent = [f"{joint} {name}" for (joint, name, _), size in zip(names, length, strict=True) if size == 0]
    if silent:
        raise ValueError(f"the motion tells nothing of {', '.join(silent)}: move these joints")
    _, values, directions = np.linalg.svd(a / length, full_matrices=False)
    least = np.abs(directions[-1])
    mixed = [f"{names[i][0]} {names[i][1]}" for i in np.argsort(-least) if least[i] > MIXED * least.max()]
    if len(values) < a.shape[1] or values[-1] < 1e-9 * values[0]:
        raise ValueError(f"the motion does not tell {', '.join(mixed)} apart: move all joints, with more frequencies")
    return float(values[0] / values[-1]), mixed


def _is_vague(each: Parameter, column: Vector, y: Vector) -> bool:
    """Whether what is not known of it matters: of its value where that cannot be 0, else of its joint's torque."""
    half = 1.96 * each.error
    if each.name in ("inertia", "moment"):
        return half > VAGUE * abs(each.value)
    return half * float(np.sqrt(np.mean(column**2))) > FELT * float(np.sqrt(np.mean(y**2)))


def _warnings(
    joints: Sequence[str], parameters: Sequence[Parameter], rows: Rows, condition: float, mixed: list[str]
) -> list[str]:
    found = []
    for column, each in enumerate(parameters):
        of = rows.joint == joints.index(each.joint)
        if of.any() and _is_vague(each, rows.a[of, column], rows.y[of]):
            found.append(
                f"{each.joint}: its {each.name} is known to +-{1.96 * each.error:.2g} {each.unit} only "
                f"({int(of.sum())} windows with motion): move this joint farther and faster "
                "(lithe.identify.design_multisine)"
            )
    if condition > ENTANGLED:
        found.append(
            f"the motion hardly tells {', '.join(mixed)} apart (condition number {condition:.0f}, good is below "
            f"{ENTANGLED:.0f}): move all joints at once, with several frequencies (lithe.identify.design_multisine)"
        )
    return found


def identify_chain(
    chain: Description,
    motions: Sequence[Sequence[Motion]],
    window_s: float = WINDOW_S,
    moving_rad_s: float = MOVING_RAD_S,
    look_further: bool = False,
) -> ChainFit:
    """Fits one or more motions, each a Motion per joint with the same times.

    ValueError where shapes differ, or where the motion tells nothing of a parameter; the words name it. Where it tells
    little, `warnings` say of what, and what to do. `look_further`: also which term that was not fitted would explain
    what is left (`missing`); it takes a few times as long.
    """
    rows = _equations(chain, motions, window_s, moving_rad_s)
    names = names_of(chain)
    if len(rows.y) < 4 * OVERLAP * len(chain.names) + len(names):
        raise ValueError(f"only {len(rows.y)} equations for {len(names)} parameters: record longer, or move more")
    condition, mixed = _check_rank(rows.a, names)
    kept = list(range(len(names)))
    value, spread = np.zeros(len(names)), np.zeros((len(names), len(names)))
    while True:
        solution, found = _solve(rows.a[:, kept], rows.y, rows.joint), _covariance(rows.a[:, kept], rows)
        errors = np.sqrt(np.diag(found))
        drives = [i for i, column in enumerate(kept) if names[column][1] in BOUNDED and solution[i] < 0]
        if not drives:
            break
        least = min(drives, key=lambda i: float(solution[i] / errors[i]))
        spread[kept[least], kept[least]] = found[
            least, least
        ]  # within the noise it is 0, and no better known than that
        del kept[least]
    value[kept], spread[np.ix_(kept, kept)] = solution, found
    parameters = tuple(Parameter(*name, float(value[i]), float(np.sqrt(spread[i, i]))) for i, name in enumerate(names))
    residual = (rows.y - rows.a @ value) / window_s
    of = {name: rows.joint == k for k, name in enumerate(chain.names)}
    return ChainFit(
        parameters,
        {name: float(np.sqrt(np.mean(residual[here] ** 2))) if here.any() else 0.0 for name, here in of.items()},
        condition,
        len(np.unique(rows.window)),
        (
            *_warnings(chain.names, parameters, rows, condition, mixed),
            *(left_out(chain, rows, value) if look_further else ()),
        ),
        {
            key: value
            for key, value in (("stribeck_rad_s", chain.stribeck_rad_s), ("cogging_per_turn", chain.cogging_per_turn))
            if value > 0
        },
        tuple(map(tuple, spread.tolist())),
    )


def payload(chain: Description, before: ChainFit, after: ChainFit) -> Payload:
    """The point mass on the last link by which two fits of the same chain differ.

    A mass m at r adds L_i m to the moment of each inner link and m r to that of the last. ValueError for a single link
    (only m r can be told) and where the difference is within its errors.
    """
    joints = len(chain.names)
    if joints < 2:
        raise ValueError("a chain of one link tells only mass times reach: the difference of its moments")
    moments = [[k for k, each in enumerate(fit.parameters) if each.name == "moment"] for fit in (before, after)]
    gain = np.array([after[name, "moment"].value - before[name, "moment"].value for name in chain.names])
    spread = sum(np.array(fit.covariance)[np.ix_(at, at)] for fit, at in zip((before, after), moments, strict=True))
    least = 1e-12 * np.eye(joints)  # two fits of the same motion differ by nothing
    # gain = model (m, m r): generalised least squares
    model = np.zeros((joints, 2))
    model[:-1, 0], model[-1, 1] = chain.length_m[: joints - 1], 1.0
    weighted = model.T @ np.linalg.inv(spread + least)
    found = np.linalg.inv(weighted @ model)
    mass, moment = (float(each) for each in found @ weighted @ gain)
    mass_error = float(np.sqrt(found[0, 0]))
    if mass < 2 * mass_error:
        raise ValueError(
            f"the payload is {mass:.4f} +- {mass_error:.4f} kg: no difference that stands clear of its error"
        )
    by = np.array([-moment / mass, 1.0]) / mass  # how the reach changes with both
    return Payload(mass, mass_error, moment / mass, float(np.sqrt(by @ found @ by)))
