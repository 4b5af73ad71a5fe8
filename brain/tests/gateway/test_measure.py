# SPDX-License-Identifier: Apache-2.0
"""The gateway's verb `measure`: which ticks count, and at which instant an error is one."""

import numpy as np
import pytest
import synthetic
from lithe import Refused
from lithe._wire import Mode
from lithe.gateway.measure import measured
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
    with pytest.raises(Refused, match="hold"):
        measured(records, np.ones(400), ["joint"])
