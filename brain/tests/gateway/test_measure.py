# SPDX-License-Identifier: Apache-2.0
"""The gateway's verb `measure`: which ticks count, and at which instant an error is one."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import synthetic
from lithe import Refused
from lithe._wire import Mode, PlanState, TelemetryFlags
from lithe.gateway.measure import measured, position_step_rad
from lithe.remote import Remote


def test_the_running_law_is_measured(remote: Remote) -> None:
    told = remote.call("measure", seconds=0.5)
    assert told["law_id"] == remote.call("latest", fields=["law_id"])["law_id"]
    assert 0 < told["ticks"] <= 500 and told["seconds"] <= 0.5
    (joint,) = told["joints"].values()
    assert 0 <= joint["median_error_rad"] <= joint["max_error_rad"]
    assert 0 <= joint["rms_torque_nm"] <= joint["max_torque_nm"]


def test_an_error_is_measured_at_the_instant_of_the_sample_and_under_one_law() -> None:
    records = synthetic.records(400)
    records["mode"], records["law_id"], records["release_jitter_ns"] = Mode.active, 7, 0
    t_s = np.arange(400) * 1e-3
    records["release_ns"] = 1_000_000_000 + np.arange(400) * 1_000_000
    records["sample_ns"] = records["release_ns"] - 1_000_000  # a period older than the setpoint
    records["setpoint_velocity_rad_s"][:, 0] = 2.0
    records["setpoint_position_rad"][:, 0] = 2.0 * t_s
    records["position_rad"][:, 0] = 2.0 * (t_s - 1e-3)  # exactly on the way
    records["law_id"][:100], records["position_rad"][:100] = 6, 9.0  # another law's
    records["mode"][200], records["position_rad"][200] = Mode.hold, 9.0
    told = measured(records, np.ones(400), ["joint"])
    assert told["ticks"] == 299
    assert told["joints"]["joint"]["max_error_rad"] < 1e-12
    records["sample_ns"] = records["release_ns"]  # so the error of a joint that lags by a period is seen
    assert measured(records, np.ones(400), ["joint"])["joints"]["joint"]["rms_error_rad"] == pytest.approx(2e-3)
    records["mode"][-1] = Mode.hold
    with pytest.raises(Refused, match="in mode hold the law runs"):
        measured(records, np.ones(400), ["joint"])
    records["mode"][-1] = Mode.safe_stop
    with pytest.raises(Refused, match="no law runs: the robot is in mode safe_stop"):
        measured(records, np.ones(400), ["joint"])


def moving(ticks: int, joints: int) -> npt.NDArray[Any]:
    """Of a law that runs, along a plan; the guard changes nothing."""
    records = synthetic.records(ticks, joints)
    records["mode"], records["law_id"], records["plan_state"] = Mode.active, 7, PlanState.track
    records["release_ns"] = 1_000_000_000 + np.arange(ticks) * 1_000_000
    records["brain_age_ns"], records["flags"], records["missed_releases"] = 10_000_000, 0, 0
    records["command_torque_nm"] = records["law_torque_nm"] = 0.5
    return records


def test_a_setpoint_that_stood_still_is_told_with_its_time_and_cause() -> None:
    records = moving(400, 1)
    assert not {"setpoint_rested_s", "warning"} & set(measured(records, np.ones(400), ["joint"]))
    records["plan_state"][100:150], records["plan_state"][150:200] = PlanState.coast, PlanState.hold
    told = measured(records, np.ones(400), ["joint"])
    assert told["setpoint_rested_s"] == 0.1 and "no plan was there" in told["warning"]
    records["flags"][150:200] = TelemetryFlags.brain_stale
    records["brain_age_ns"][199] = 5_000_000_000
    assert "its sender was silent for up to 5 s" in measured(records, np.ones(400), ["joint"])["warning"]
    records["law_id"][:200] = 6  # that was another law's time
    assert "warning" not in measured(records, np.ones(400), ["joint"])


def test_the_joint_that_the_guard_changed_is_told_with_the_flags() -> None:
    records = moving(400, 2)
    records["flags"][:4], records["command_torque_nm"][:4, 1] = TelemetryFlags.position_clamped, -0.2
    records["command_torque_nm"][4:, 0] = 0.6  # without such a flag it is not the guard's
    told = measured(records, np.ones(400), ["arm", "hand"])["joints"]
    assert told["hand"]["clamped_share"] == 0.01 and told["hand"]["clamped_by"] == ["position_clamped"]
    assert "clamped_share" not in told["arm"]


def test_the_step_of_the_encoder_and_the_least_error_are_told() -> None:
    """A goal below the resolution of a position sensor cannot be reached by any law."""
    records, t_s = moving(4000, 3), np.arange(4000) * 1e-3
    swing_rad = 0.2 * np.sin(2 * np.pi * 0.5 * t_s)
    step_rad = 2 * np.pi / 16384
    records["position_rad"][:, 0] = swing_rad
    records["position_rad"][:, 1] = np.round(swing_rad / step_rad) * step_rad + 0.3
    records["position_rad"][:, 2] = np.random.default_rng(1).normal(0, 0.1, 4000)
    told = measured(records, np.ones(4000), ["fine", "coarse", "noisy"])["joints"]
    assert told["coarse"]["position_step_rad"] == pytest.approx(step_rad, rel=0.01)
    assert told["coarse"]["least_rms_error_rad"] == pytest.approx(step_rad / 12**0.5, rel=0.01)
    assert not {"position_step_rad", "least_rms_error_rad"} & (set(told["fine"]) | set(told["noisy"]))
    assert position_step_rad(records["position_rad"][:15, 1]) is None, "too few positions"
