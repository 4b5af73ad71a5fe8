# SPDX-License-Identifier: Apache-2.0
"""Recording every tick, and what the files say."""

import csv
from pathlib import Path

import lithe
import numpy as np
import pytest
import synthetic
from lithe.demo import recorder
from system.robot_rig import RobotRig


def test_every_tick_is_recorded_while_the_brain_does_what_it_likes(robot: lithe.Robot) -> None:
    recording = recorder.Recorder(robot.name)
    from_tick = int(robot.status()["tick"])
    RobotRig.wait_for(lambda: int(robot.status()["tick"]) > from_tick + 1000)
    ticks = recording.finish()["tick"].astype(np.int64)
    assert recording.lost == 0 and len(ticks) > 1000
    assert np.array_equal(ticks, np.arange(ticks[0], ticks[0] + len(ticks)))


def test_npz_and_csv_say_the_same_to_the_last_nanosecond(tmp_path: Path) -> None:
    made = synthetic.records(500)
    made["release_ns"] += 2**60 + 1  # a double would round it
    recorder.save(made, tmp_path)
    columns = np.load(tmp_path / "telemetry.npz")
    with (tmp_path / "telemetry.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 500
    assert [int(row["release_ns"]) for row in rows] == columns["release_ns"].tolist()
    assert columns["position_rad"].shape == (500, 1)
    assert float(rows[7]["position_rad[0]"]) == pytest.approx(columns["position_rad"][7, 0], rel=1e-5)
