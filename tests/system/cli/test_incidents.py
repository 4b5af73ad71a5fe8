# SPDX-License-Identifier: Apache-2.0
"""The flight recorder, on a running robot: from the fault to the picture."""

import json
from pathlib import Path

import numpy as np
import pytest
from lithe import incident
from lithe.errors import LitheError
from system.robot_rig import RobotRig

CRASHES = """
#include <lithe/law.hpp>
struct Crashes {
  struct Params {};
  struct State { std::uint32_t steps = 0; };
  static void step(const lithe::Tick& in, const Params&, State& s, lithe::Effort& out) {
    if (++s.steps > 6000) *(volatile int*)8 = 1;  // longer than a trial looks
    out.torque_nm[0] = -0.5 * in.position_rad[0] - 0.02 * in.velocity_rad_s[0];
  }
};
LITHE_LAW(Crashes, "crashes");
"""


def test_a_crash_is_kept_with_a_second_before_and_after(arm: RobotRig) -> None:
    """Summary, telemetry and picture; found by verb, by command and, when the robot is gone, by folder."""
    path = arm.dir / "crashes.cpp"
    path.write_text(CRASHES)
    arm.ask("swap", path)

    def kept() -> list[int]:
        answer = arm.raw(json.dumps({"verb": "incidents", "id": 1}).encode() + b"\n")["result"]
        assert answer["problem"] is None
        return [each["id"] for each in answer["incidents"] if each["kind"] == "law_faulted"]

    arm.wait_for(lambda: len(kept()) == 1)
    (number,) = kept()
    told = arm.ask("incident", "show", str(number))
    assert "bad_access" in told["what"]
    assert told["law"]["before"]["name"] == "crashes" and told["law"]["after"]["name"] == "pd"
    assert "law_rolled_back" in [each["kind"] for each in told["events"]]

    summary, records = incident.load(told["path"])
    assert summary["tick"] == told["tick"]
    assert records["position_rad"].shape == (len(records), 1)
    around_ns = records["release_ns"] - summary["t_ns"]
    assert around_ns[0] < -0.99e9 and around_ns[-1] > 0.99e9, "it waited for what came after"
    missed = int(records["missed_releases"][-1] - records["missed_releases"][0])
    assert (np.diff(records["tick"].astype(np.int64)) >= 1).all()
    assert len(records) + missed == pytest.approx(2000, abs=3)
    assert summary["tick"] in records["tick"]

    picture = arm.dir / "incident.svg"
    drawn = arm.lithe("incident", "plot", str(number), "--out", str(picture))
    assert drawn.returncode == 0, drawn.stderr
    assert "<svg" in picture.read_text()

    folder = str(Path(told["path"]).parent)
    arm.ask("stop")
    arm.wait_for(lambda: not arm.socket.exists())
    listed = json.loads(arm.lithe("incident", "list", "--folder", folder, "--json").stdout)
    assert number in [each["id"] for each in listed["incidents"]]


def test_what_is_no_incident_is_refused(tmp_path: Path) -> None:
    """Absent, cut, and of another kind."""
    with pytest.raises(LitheError, match="lithe incident list"):
        incident.load(tmp_path / "0001.npy")
    (tmp_path / "0001.json").write_text("[]")
    np.save(tmp_path / "0001.npy", np.zeros(3))
    with pytest.raises(LitheError, match="no incident"):
        incident.load(tmp_path / "0001.npy")
    (tmp_path / "0001.npy").write_bytes((tmp_path / "0001.npy").read_bytes()[:40])
    with pytest.raises(LitheError, match="cannot read"):
        incident.load(tmp_path / "0001.json")
    assert incident.main([str(tmp_path / "0002.npy")]) == 1
