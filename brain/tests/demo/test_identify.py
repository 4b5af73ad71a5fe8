# SPDX-License-Identifier: Apache-2.0
"""The estimate, on simulated arms that the estimator has never seen, through the agent's own two probes."""

from dataclasses import replace

import numpy as np
import pytest
from arm_sim import Law, SimArm
from lithe.demo.moves import PROBE_SHARES
from lithe.identify import Motion, identify_arm, identify_joint, mgl_at_rest, torque_lag_s


def constant(torque_nm: float) -> Law:
    return lambda t_s, _q, _v: torque_nm * min(1.0, t_s / 0.05)


def some_arm(seed: int) -> SimArm:
    rng = np.random.default_rng(seed)
    mgl_nm = rng.uniform(0.08, 0.3)
    return SimArm(
        mgl_nm=mgl_nm,
        inertia_kg_m2=mgl_nm * rng.uniform(0.012, 0.02),
        viscous_nm_s_rad=rng.uniform(0.0, 6e-4),
        coulomb_nm=mgl_nm * rng.uniform(0.04, 0.12),
        torque_lag_s=rng.uniform(0.0008, 0.0016),
        angle_rad=rng.uniform(-0.05, 0.6),
    )


def probe(arm: SimArm, seed: int) -> list[Motion]:
    """The agent knows mgl only roughly when it chooses the torques."""
    rough_nm = arm.mgl_nm * np.random.default_rng(seed + 1000).uniform(0.85, 1.15)
    return [arm.run(constant(share * rough_nm), 3.0, torque_noise_nm=5e-4, seed=seed) for share in PROBE_SHARES]


@pytest.mark.parametrize("seed", range(12))
def test_two_probes_tell_mgl_within_one_percent_whatever_the_arm(seed: int) -> None:
    arm = some_arm(seed)
    found = identify_arm(probe(arm, seed))
    assert abs(found.mgl_nm / arm.mgl_nm - 1) < 0.01
    assert abs(found.mgl_nm - arm.mgl_nm) < 3 * found.mgl_se_nm
    assert found.mgl_se_nm < 0.02 * arm.mgl_nm
    assert found.inertia_kg_m2 == pytest.approx(arm.inertia_kg_m2, rel=0.02)
    assert found.coulomb_nm == pytest.approx(arm.coulomb_nm, rel=0.05)
    assert found.viscous_nm_s_rad >= 0


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("off_rad", [-0.02, 0.0087])
def test_an_encoder_that_is_off_does_not_make_the_arm_heavier(seed: int, off_rad: float) -> None:
    """The probes swing to one side only: an angle that is off looks like weight there, unless it is estimated too."""
    arm = some_arm(seed)
    told = [replace(motion, position_rad=motion.position_rad + off_rad) for motion in probe(arm, seed)]
    found = identify_arm(told)
    assert abs(found.mgl_nm - arm.mgl_nm) < 3 * found.mgl_se_nm
    assert found.mgl_nm == pytest.approx(arm.mgl_nm, rel=0.01)
    assert found.zero_rad == pytest.approx(-off_rad, abs=0.003)


@pytest.mark.parametrize("seed", range(6))
def test_the_probes_never_go_over_the_top(seed: int) -> None:
    arm = some_arm(seed)
    assert max(float(np.max(np.abs(motion.position_rad))) for motion in probe(arm, seed)) < np.radians(120)


def test_rest_alone_misses_by_the_friction_and_says_so() -> None:
    worst = 0.0
    for seed in range(8):
        arm = some_arm(seed)
        ends = [arm.run(constant(share * arm.mgl_nm), 9.0) for share in PROBE_SHARES]
        torques = np.array([motion.torque_nm[-300:].mean() for motion in ends])
        angles = np.array([motion.position_rad[-300:].mean() for motion in ends])
        rest_nm, rest_se_nm = mgl_at_rest(torques, angles, arm.coulomb_nm)
        worst = max(worst, abs(rest_nm / arm.mgl_nm - 1))
        assert abs(rest_nm - arm.mgl_nm) < 3 * rest_se_nm
    assert worst > 0.02  # why the swing is used: here rest alone is off by more


def test_an_arm_that_rests_is_refused() -> None:
    still = SimArm().run(lambda *_: 0.0, 2.0)
    with pytest.raises(ValueError, match="excite the arm more"):
        identify_arm([still])


@pytest.mark.parametrize("seed", range(4))
def test_a_machine_that_skips_ticks_and_repeats_samples_costs_little(seed: int) -> None:
    arm = some_arm(seed)
    rng = np.random.default_rng(seed)
    spoilt = []
    for motion in probe(arm, seed):
        late = np.flatnonzero(rng.random(len(motion.t_s)) < 0.02)  # here 1 to 10 ticks are skipped
        keep = np.ones(len(motion.t_s), bool)
        for start in late:
            keep[start : start + rng.integers(1, 11)] = False
        taken = np.repeat(np.flatnonzero(keep), np.where(rng.random(np.count_nonzero(keep)) < 0.1, 2, 1))
        spoilt.append(Motion(*(np.asarray(column)[taken] for column in vars(motion).values())))
    found = identify_arm(spoilt)
    assert abs(found.mgl_nm / arm.mgl_nm - 1) < 0.02
    assert found.inertia_kg_m2 == pytest.approx(arm.inertia_kg_m2, rel=0.04)


def test_a_gap_in_the_record_is_left_out() -> None:
    arm = some_arm(3)
    whole = probe(arm, 3)
    keep = np.r_[0:400, 700 : len(whole[0].t_s)]
    holed = Motion(*(getattr(whole[0], name)[keep] for name in ("t_s", "position_rad", "velocity_rad_s", "torque_nm")))
    assert identify_arm([holed, whole[1]]).mgl_nm == pytest.approx(arm.mgl_nm, rel=0.02)


def test_gaps_longer_than_a_window_are_left_out_wherever_they_are() -> None:
    arm = some_arm(3)
    whole = probe(arm, 3)
    for first in range(50, 900, 50):
        keep = np.r_[0:first, first + 70 : len(whole[0].t_s)]
        holed = Motion(*(np.asarray(column)[keep] for column in vars(whole[0]).values()))
        assert identify_arm([holed, whole[1]]).mgl_nm == pytest.approx(arm.mgl_nm, rel=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_slow_ticks_of_which_a_third_are_missing_still_tell(seed: int) -> None:
    arm = some_arm(seed)
    chance = np.random.default_rng(seed)
    slow = []
    for motion in probe(arm, seed):
        kept = np.flatnonzero((np.arange(len(motion.t_s)) % 2 == 0) & (chance.random(len(motion.t_s)) > 0.33))
        slow.append(Motion(*(np.asarray(column)[kept] for column in vars(motion).values())))
    assert identify_arm(slow).mgl_nm == pytest.approx(arm.mgl_nm, rel=0.02)


def follow(arm: SimArm, gain_nm_rad: float, seconds: float = 4.0) -> Motion:
    """A PD tracks a sine about a right angle."""

    def law(t_s: float, q_rad: float, v_rad_s: float) -> float:
        wanted_rad = np.pi / 2 * min(1.0, t_s) + 0.8 * np.sin(np.pi * t_s)
        return gain_nm_rad * (wanted_rad - q_rad) - 0.1 * gain_nm_rad * v_rad_s

    return arm.run(law, seconds, torque_noise_nm=5e-4)


@pytest.mark.parametrize("seed", range(6))
def test_a_joint_that_only_follows_tells_as_much(seed: int) -> None:
    arm = some_arm(seed)
    found = identify_joint([follow(arm, arm.mgl_nm)])
    assert found.mgl_nm == pytest.approx(arm.mgl_nm, rel=0.03)
    assert found.inertia_kg_m2 == pytest.approx(arm.inertia_kg_m2, rel=0.05)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("share", [0.0, 0.3])
def test_a_joint_whose_friction_bears_all_gravity_has_none(seed: int, share: float) -> None:
    arm = some_arm(seed)
    gain_nm_rad, arm.mgl_nm = arm.mgl_nm, share * arm.coulomb_nm
    found = identify_joint([follow(arm, gain_nm_rad)])
    assert (found.mgl_nm, found.mgl_se_nm) == (0.0, 0.0)
    assert found.inertia_kg_m2 == pytest.approx(arm.inertia_kg_m2, rel=0.15)
    assert found.coulomb_nm == pytest.approx(arm.coulomb_nm, rel=0.3)


def test_a_joint_that_rests_is_refused_whether_it_bears_gravity_or_not() -> None:
    with pytest.raises(ValueError, match="excite the arm more"):
        identify_joint([SimArm(mgl_nm=0.0).run(lambda *_: 0.0, 2.0)])


@pytest.mark.parametrize("lag_s", [0.0, 0.002, 0.0055, 0.02])
def test_the_lag_of_a_torque_is_found_among_records_that_tell_nothing(lag_s: float) -> None:
    t_s = np.arange(0, 3, 0.001)
    command = np.sin(2 * t_s) + 0.2 * np.sign(np.sin(7 * t_s))
    measured = np.interp(t_s - lag_s, t_s, command) + 1e-3 * np.random.default_rng(1).standard_normal(len(t_s))
    constant = (t_s, np.full(len(t_s), 0.3), np.full(len(t_s), 0.3))
    assert torque_lag_s([constant, (t_s, command, measured), constant]) == pytest.approx(lag_s, abs=3e-4)
    assert torque_lag_s([constant]) == 0.0
