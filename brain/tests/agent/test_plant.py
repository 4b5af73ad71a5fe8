# SPDX-License-Identifier: Apache-2.0
"""What a language model is told of a chain: the equations, against a plant that was written without them."""

import re

import numpy as np
import pytest
from chain_sim import STEP_S, Chains
from lithe.agent.plant import CHAIN, identified
from lithe.agent.reference import Asked, reference_of
from lithe.gateway.curves import curve_of
from lithe.identify import Motion

MADE = Chains.drawn(1, 3, seed=5)
NAMES = ["joint0", "joint1", "joint2"]


def coupling(which: str, i: int, j: int, theta: np.ndarray, moment: list[float]) -> float:
    """A_ij or H_ij, i != j, as the text says it."""
    found = re.search(rf"{which}_ij = (L_n \* mu_f \* \w+\(theta_i - theta_j\))", CHAIN)
    assert found is not None
    values = {
        "L_n": MADE.length_m[0, min(i, j)], "mu_f": moment[max(i, j)], "theta_i": theta[i], "theta_j": theta[j],
        "sin": np.sin, "cos": np.cos,
    }  # fmt: skip
    return float(eval(found[1], {"__builtins__": {}}, values))


def test_the_equations_are_those_of_a_plant_that_was_written_without_them() -> None:
    truth, rng = MADE.truth(0), np.random.default_rng(3)
    moment = [truth[name, "moment"] for name in NAMES]
    q, v, wanted = rng.uniform(-1, 1, (3, 3)) * np.array([[1.0], [3.0], [20.0]])
    theta, w, a = np.cumsum(q), np.cumsum(v), np.cumsum(wanted)
    link = np.zeros(3)
    for i in range(3):
        link[i] = 9.81 * moment[i] * np.sin(theta[i]) + truth[NAMES[i], "inertia"] * a[i]
        for j in set(range(3)) - {i}:
            link[i] += coupling("A", i, j, theta, moment) * a[j] + coupling("H", i, j, theta, moment) * w[j] ** 2
    torque = np.array([
        truth.get((name, "rotor"), 0.0) * wanted[k] + truth[name, "viscous"] * v[k]
        + truth[name, "coulomb"] * np.tanh(v[k] / 0.02) + link[k:].sum()
        for k, name in enumerate(NAMES)
    ])  # fmt: skip
    assert MADE.acceleration()(q[None], v[None], torque[None])[0] == pytest.approx(wanted, rel=1e-9)


def test_the_sine_of_the_agent_tells_the_coupled_model() -> None:
    joint = {"position_min_rad": -2.5, "position_max_rad": 2.5, "velocity_max_rad_s": 15.0}
    sine = reference_of([{"name": name, **joint} for name in NAMES], "0.5 Hz", Asked())
    motion = MADE.follow(curve_of(sine.terms, 3)(np.arange(4000) * STEP_S))[0]
    equations, found = identified(NAMES, [motion], MADE.description(0))
    assert equations == CHAIN and not [one for one in found if "warning" in one or "why" in one]
    told = {one["joint"]: one for one in found if "joint" in one}
    for name in NAMES:
        assert told[name]["moment_kg_m"] == pytest.approx(MADE.truth(0)[name, "moment"], rel=0.02)
        assert told[name]["inertia_kg_m2"] == pytest.approx(MADE.truth(0)[name, "inertia"], rel=0.15)
    single, alone = identified(NAMES, [motion])
    assert single != CHAIN and [one["joint"] for one in alone] == NAMES, "a robot that is no chain"


def test_a_motion_that_does_not_tell_it_says_why_and_each_joint_by_itself() -> None:
    t = np.arange(4000) * 0.001
    still = [Motion(t, np.zeros(4000), np.zeros(4000), np.zeros(4000)) for _ in NAMES]
    equations, found = identified(NAMES, [still], MADE.description(0))
    assert equations != CHAIN and "no window with motion" in found[0]["why"]
    assert [one["joint"] for one in found[1:]] == NAMES
