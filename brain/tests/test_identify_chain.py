# SPDX-License-Identifier: Apache-2.0
"""The parameters of chains that the estimator has never seen, and what it says when the motion tells too little."""

import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import lithe.identify.chain as fit_module
import numpy as np
import pytest
from chain_sim import COGGING_PER_TURN, STEP_S, STRIBECK_RAD_S, Chains
from lithe.errors import LitheError
from lithe.gateway.references import Limits, curve_of
from lithe.identify import ChainFit, Description, Motion, describe, design_multisine, identify_chain, payload
from lithe.identify.design import information
from lithe.identify.regressor import Matrix, Rows

ROOT = Path(__file__).resolve().parents[2]
ROBOTS = 50
LIMITS = Limits([f"joint{k}" for k in range(3)], np.full(3, -1.2), np.full(3, 1.2), np.full(3, 5.0))
# What design_multisine finds for LIMITS in 20 s; here as numbers, so that a test of the fit is none of the design.
REFERENCE: dict[str, Any] = {
    "kind": "multisine", "centre_rad": [0.2, -0.1, 0.1], "amplitude_rad": [1.0, 1.1, 1.2],
    "frequency_hz": [0.3, 0.7, 1.1, 1.9],
}  # fmt: skip


Rough = list[tuple[Description, dict[tuple[str, str], float], list[list[Motion]]]]
Found = tuple[Chains, list[ChainFit], list[list[Motion]]]
SECONDS = 10.0


def changed(made: Chains, **values: float) -> Chains:
    """One chain with other values of its last joint."""
    own = {name: getattr(made, name).copy() for name in values}
    for name, value in values.items():
        own[name][0, -1] = value
    return replace(made, **own)


def loaded(made: Chains, mass_kg: float, reach_m: float) -> Chains:
    """With a point mass on the last link."""
    own_kg, own_m, own_kg_m2 = (float(getattr(made, name)[0, 2]) for name in ("mass_kg", "centre_m", "inertia_kg_m2"))
    total = own_kg + mass_kg
    centre = (own_kg * own_m + mass_kg * reach_m) / total
    inertia = own_kg_m2 + own_kg * own_m**2 + mass_kg * reach_m**2 - total * centre**2
    return changed(made, mass_kg=total, centre_m=centre, inertia_kg_m2=inertia)


PAYLOAD = (0.15, 0.09)
ONE = Chains.drawn(1, 3, seed=11)
SMOOTH = replace(ONE, viscous_nm_s_rad=np.zeros((1, 3)))
# Of each motion of a single chain: the chain, how its reference differs, the noise of its torque [N m].
SINGLE: dict[str, tuple[Chains, dict[str, Any], float]] = {
    "usual": (ONE, {}, 0.01),
    "slow": (ONE, {"amplitude_rad": [0.9, 0.9, 0.05], "frequency_hz": [0.25, 1.5]}, 0.3),
    "two joints": (ONE, {"amplitude_rad": [0.8, 0.8, 0.0]}, 0.01),
    "smooth": (SMOOTH, {}, 0.01),
    "loaded": (loaded(ONE, *PAYLOAD), {}, 0.01),
}


ROUGH = 6  # robots whose joints are harder to turn at rest and at some angles; they move fast, and then slowly
SLOW = {"amplitude_rad": [0.7, 0.8, 0.9], "frequency_hz": [0.1, 0.3]}
ROUGH_NM = np.array([0.025, 0.02, 0.015]) * np.random.default_rng(8).uniform(0.7, 1.3, (3, ROUGH, 3))


@pytest.fixture(scope="module")
def recorded() -> tuple[Chains, dict[str, list[Motion]], list[list[Motion]]]:
    """Robots, the motions of SINGLE, and those of the robots. Simulated at once: numpy takes as long for one."""
    rough = replace(Chains.drawn(ROUGH, 3, seed=6), stribeck_nm=ROUGH_NM[0], cogging_cos_nm=ROUGH_NM[1],
                    cogging_sin_nm=-ROUGH_NM[2])  # fmt: skip
    made = Chains.together([Chains.drawn(ROBOTS, 3, seed=5), rough, rough])
    t = np.arange(round(SECONDS / STEP_S)) * STEP_S
    robots = ROBOTS + 2 * ROUGH
    curves = [curve_of(REFERENCE, 3)(t)] * (ROBOTS + ROUGH)
    curves += [curve_of({**REFERENCE, **SLOW}, 3)(t)] * ROUGH
    curves += [curve_of({**REFERENCE, **other}, 3)(t) for _, other, _ in SINGLE.values()]
    noise_nm = np.array([[0.01]] * robots + [[each] for *_, each in SINGLE.values()])
    together = Chains.together([made, *(one for one, *_ in SINGLE.values())])
    motions = together.follow(np.stack(curves, axis=1), noise_nm, seed=1)
    return made, dict(zip(SINGLE, motions[robots:], strict=True)), motions[:robots]


@pytest.fixture(scope="module")
def chains(recorded: Any) -> Found:
    """Fifty robots, what was found of each, and from which motion."""
    made, _, motions = recorded
    motions = motions[:ROBOTS]
    return made, [identify_chain(made.description(i), [motion]) for i, motion in enumerate(motions)], motions


@pytest.fixture(scope="module")
def rough(recorded: Any) -> Rough:
    """Robots with Stribeck friction and cogging: description, truth, both motions."""
    made, _, motions = recorded
    return [
        (made.description(i), made.truth(i), [motions[i], motions[i + ROUGH]]) for i in range(ROBOTS, ROBOTS + ROUGH)
    ]


@pytest.fixture(scope="module")
def single(recorded: Any) -> dict[str, list[Motion]]:
    """Motions of SINGLE, by name."""
    return dict(recorded[1])


def covered(made: Chains, fits: list[ChainFit], factor: float = 1.0) -> float:
    """Share of all true parameters that lie in their intervals, made `factor` times as wide."""
    inside = [
        abs(each.value - made.truth(i)[each.joint, each.name]) <= factor * 1.96 * each.error
        for i, fit in enumerate(fits) for each in fit.parameters
    ]  # fmt: skip
    return float(np.mean(inside))


def test_the_intervals_hold_the_truth_in_nine_of_ten(chains: Found, tell: Any) -> None:
    made, fits, _ = chains
    held, half = covered(made, fits), covered(made, fits, 0.3)
    each = {
        key: np.mean([abs(fit[key].value - made.truth(i)[key]) <= 1.96 * fit[key].error for i, fit in enumerate(fits)])
        for key in made.truth(0)
    }
    assert min(each.values()) >= 0.8, each  # no parameter hides among the others
    tell(f"95 % intervals hold {held:.1%} of the parameters of {ROBOTS} robots, a third as wide {half:.1%}")
    assert held >= 0.9
    assert half < 0.9, "intervals that are much too narrow are seen"


def test_they_are_narrow_enough_to_be_of_use(chains: Found, tell: Any) -> None:
    _, fits, _ = chains
    shares = {name: float(np.median([1.96 * each.error / each.value for fit in fits for each in fit.parameters
                                     if each.name == name])) for name in ("moment", "inertia")}  # fmt: skip
    tell(", ".join(f"{name} +-{share:.1%}" for name, share in shares.items()))
    assert shares["moment"] < 0.03 and shares["inertia"] < 0.1
    assert not any(fit.warnings for fit in fits)


def test_friction_near_rest_and_cogging_are_found_within_their_intervals(rough: Rough, tell: Any) -> None:
    found = [(identify_chain(chain, motions), truth) for chain, truth, motions in rough]
    for what in ("stribeck", "cogging_cos", "cogging_sin"):
        off = [(fit[key].value - true) / fit[key].error for fit, truth in found for key, true in truth.items()
               if key[1] == what]  # fmt: skip
        width = np.median([1.96 * fit[key].error for fit, truth in found for key in truth if key[1] == what])
        share = np.mean(np.abs(off) < 1.96)
        tell(f"{what}: {share:.0%} of {len(off)} intervals hold the truth, median +-{width:.4f} N m")
        assert share >= 0.8
        assert width < 0.01, "they are narrow enough to tell it from 0"
    held = np.mean(
        [abs(fit[key].value - true) < 1.96 * fit[key].error for fit, truth in found for key, true in truth.items()]
    )
    assert held >= 0.9
    assert found[0][0].given == {"stribeck_rad_s": STRIBECK_RAD_S, "cogging_per_turn": COGGING_PER_TURN}


@pytest.mark.parametrize(
    ("known", "says", "least"),
    [
        ({"cogging_per_turn": 0.0}, "repeats about 14 times in a turn: cogging_nm", 1.0),
        ({"stribeck_rad_s": 0.0}, r"falls with the speed: stribeck_nm with stribeck_rad_s = 0\.[24]", 0.6),
    ],
)
def test_a_term_that_is_left_out_is_noticed(
    known: dict[str, float], says: str, least: float, rough: Rough, tell: Any
) -> None:
    """Stribeck friction not in all robots: where the fast motion leaves more than it would explain, nothing is said."""
    warnings = [
        identify_chain(replace(chain, **known), motions, look_further=True).warnings for chain, _, motions in rough
    ]
    noticed = np.mean([any(re.search(says, each) for each in those) for those in warnings])
    tell(f"without {next(iter(known))}: noticed in {noticed:.0%} of {ROUGH} robots")
    assert noticed >= least


def independent(a: Matrix, rows: Rows) -> Matrix:
    """The covariance of least squares where each residual is new, in units of its joint's spread."""
    residual = rows.y - a @ fit_module._solve(a, rows.y, rows.joint)
    spread = np.array([1.4826 * np.median(np.abs(residual[rows.joint == k])) for k in range(3)])[rows.joint]
    return np.asarray(np.linalg.inv((a / spread[:, None] ** 2).T @ a))


def test_residuals_counted_as_independent_give_intervals_that_are_wrong(
    chains: Found, monkeypatch: pytest.MonkeyPatch, tell: Any
) -> None:
    """The twin: windows that overlap, and joints that disturb each other, told as if they were as many witnesses."""
    monkeypatch.setattr(fit_module, "_covariance", independent)
    made, fits, motions = chains
    wrong = [identify_chain(made.description(i), [motion]) for i, motion in enumerate(motions)]
    tell(f"residuals counted as independent: {covered(made, wrong):.1%}")
    assert covered(made, wrong) < 0.85


CHAIN = ONE.description(0)


def test_a_joint_that_hardly_moves_is_warned_of(single: dict[str, list[Motion]]) -> None:
    warnings = identify_chain(CHAIN, [single["slow"]]).warnings
    assert any("joint2: its inertia is known to" in each and "design_multisine" in each for each in warnings), warnings
    (mixed,) = [each for each in warnings if "hardly tells" in each]
    assert "joint2" in mixed.split(" apart")[0], "it names the joint that does not move"


def test_friction_that_the_noise_hides_is_not_told_as_certain(single: dict[str, list[Motion]]) -> None:
    found = [identify_chain(CHAIN, [single["smooth"]])[f"joint{k}", "viscous"] for k in range(3)]
    assert all(each.low >= 0 and each.high > 0 and each.error > 0 for each in found), found
    assert all(each.low <= 3 * each.error for each in found), found


def test_what_cannot_be_told_is_named(single: dict[str, list[Motion]]) -> None:
    motion = single["two joints"]
    still = [*motion[:2], replace(motion[2], position_rad=np.zeros(len(motion[2].t_s)))]
    with pytest.raises(ValueError, match=r"joint2 rotor, joint2 viscous, joint2 coulomb.*move"):
        identify_chain(CHAIN, [still])


def test_motions_that_do_not_fit_the_chain_are_refused(single: dict[str, list[Motion]]) -> None:
    motion = [Motion(*(getattr(joint, each.name)[:500] for each in fields(Motion))) for joint in single["usual"]]
    with pytest.raises(ValueError, match="a motion has 2 joints, the chain 3"):
        identify_chain(CHAIN, [motion[:2]])
    late = replace(motion[1], t_s=motion[1].t_s + 0.01)
    with pytest.raises(ValueError, match="differ in their times"):
        identify_chain(CHAIN, [[motion[0], late, motion[2]]])
    with pytest.raises(ValueError, match="record longer"):
        identify_chain(CHAIN, [motion])


def test_outliers_do_not_move_it(single: dict[str, list[Motion]]) -> None:
    motion = single["usual"]
    at = np.random.default_rng(3).choice(len(motion[0].t_s), 8, replace=False)
    torque = motion[0].torque_nm.copy()
    torque[at] += 20.0
    spoilt = identify_chain(CHAIN, [[replace(motion[0], torque_nm=torque), *motion[1:]]])
    truth = ONE.truth(0)
    for k in range(3):
        assert spoilt[f"joint{k}", "moment"].value == pytest.approx(truth[f"joint{k}", "moment"], rel=0.05)


def test_a_payload_is_the_difference_of_two_fits(single: dict[str, list[Motion]]) -> None:
    fits = [identify_chain(CHAIN, [single[name]]) for name in ("usual", "loaded")]
    found, (mass, reach) = payload(CHAIN, *fits), PAYLOAD
    assert abs(found.mass_kg - mass) < 3 * found.mass_error_kg < 0.05
    assert abs(found.reach_m - reach) < max(3 * found.reach_error_m, 0.01)
    with pytest.raises(ValueError, match="clear of its error"):
        payload(CHAIN, fits[0], fits[0])


def test_the_design_keeps_the_limits_and_tells_more_than_a_usual_sine() -> None:
    chain = CHAIN
    found = design_multisine(chain, LIMITS, seconds=8.0, seed=2, candidates=12)
    assert found == design_multisine(chain, LIMITS, seconds=8.0, seed=2, candidates=12), (
        "the same seed, the same answer"
    )
    t = np.arange(0.0, 8.0, 0.002)
    q = curve_of(found["reference"], 3)(t)
    assert (np.abs(q) <= 1.2).all() and (np.abs(np.gradient(q, 0.002, axis=0)) <= 5.0).all()
    usual = {"kind": "multisine", "centre_rad": 0, "amplitude_rad": 0.5, "frequency_hz": [0.5, 0.8]}
    assert found["information"] > information(chain, usual, 8.0)


def test_the_design_keeps_a_limit_of_acceleration() -> None:
    most = np.array([6.0, 8.0, 10.0])
    hardest = []
    for limit in (np.inf, most):
        found = design_multisine(CHAIN, LIMITS, seconds=8.0, seed=2, candidates=6, acceleration_rad_s2=limit)
        q = curve_of(found["reference"], 3)(np.arange(0.0, 8.0, 0.002))
        hardest.append(np.abs(np.gradient(np.gradient(q, 0.002, axis=0), 0.002, axis=0)).max(axis=0))
    assert (hardest[0] > most).all(), "without the limit it is passed"
    assert (hardest[1] <= most).all() and (hardest[1] > 0.5 * most).all()


def test_a_robot_file_describes_its_chain(tmp_path: Path) -> None:
    assert describe(ROOT / "robots/chain.toml") == Description(("shoulder", "elbow", "wrist"), (0.25, 0.2, 0.12), 9.81)
    with pytest.raises(LitheError, match=r"no \[plant\] kind"):
        describe(ROOT / "robots/arm.toml")
    (tmp_path / "bad.toml").write_text("joint = 3\n[plant]\nkind = 'chain'\n")
    with pytest.raises(LitheError, match="cannot read a chain"):
        describe(tmp_path / "bad.toml")
