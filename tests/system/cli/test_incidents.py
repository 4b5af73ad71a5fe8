# SPDX-License-Identifier: Apache-2.0
"""The flight recorder, on a running robot: from the fault to the picture."""

import json
from pathlib import Path

import numpy as np
import pytest
from calm import calm_text
from lithe import incident
from lithe.errors import LitheError
from lithe.gateway import Gateway
from lithe.remote import Remote
from system.robot_rig import RobotRig
from system.simulated import running

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
    text = arm.lithe("incident", "show", str(number)).stdout
    before, after = (told["law"][side]["law_id"] for side in ("before", "after"))
    assert f"  mode active, law crashes (id {before}) -> pd (id {after}), " in text and "{" not in text
    low, high = told["joints"][0]["position_rad"]
    assert f"  shoulder     {low:.4g} to {high:.4g} rad, " in text

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


FOLLOWS_THEN_CRASHES = """
#include <lithe/law.hpp>
struct Late {
  struct Params { lithe::Param kp_nm_rad{4.0, 0.0, 40.0}; };
  struct State { std::uint32_t steps = 0; };
  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j)
      u.torque_nm[j] = double(p.kp_nm_rad) * (t.setpoint_position_rad[j] - t.position_rad[j])
                     + 0.1 * (t.setpoint_velocity_rad_s[j] - t.velocity_rad_s[j]);
    if (++s.steps > 8000) *(volatile int*)8 = 1;  // longer than a trial and its probation
  }
};
LITHE_LAW(Late, "late");
"""


def test_a_confirmed_law_that_leaves_the_chain_later_is_told_with_the_next_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Which law, why, which incident, and what leads back, though the client asked for none of it."""
    with running(calm_text(robot="chain"), monkeypatch) as (rig, robot):
        gateway = Gateway(robot, token="sesame")
        gateway.start()
        with Remote("127.0.0.1", gateway.port, "sesame") as agent:
            agent.call("set_reference", kind="sine", centre_rad=0.0, amplitude_rad=0.12, frequency_hz=1.0, stay=True)
            agent.call("measure", seconds=0.5)  # on a busy machine the motion begins late
            done = agent.call("swap", source=FOLLOWS_THEN_CRASHES, name="late.cpp", probation_s=1.0, brief=True)
            assert done["verdict"] == "confirmed" and "law_changed" not in done
            assert done["joints"]["wrist"]["rms_error_rad"]["new_late"] >= 0
            rig.wait_for(lambda: "law_faulted" in [each["kind"] for each in robot.call("incidents")["incidents"]], 60)
            told = agent.call("measure", seconds=0.5)
            number = told["law_changed"]["incident"]
            kept = agent.call("history", incident=number, fields=["tick", "law_id"], every=20)
        gateway.close()
    assert told["law"] == "pd" and set(told["params"]) == {"kp_nm_rad", "kd_nm_s_rad"}
    changed = told["law_changed"]
    assert changed["was"] == {"law": "late", "law_id": done["law_id"], "params": {"kp_nm_rad": 4.0}}
    (cause,) = [each for each in changed["because"] if each["kind"] == "law_rolled_back"]
    assert "bad_access" in cause["text"] and "index" in cause["next"]
    assert f"document {done['certificate']}.cpp" in changed["next"]
    assert "bad_access" in kept["what"] and {done["law_id"], told["law_id"]} == set(kept["law_id"])


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
    with pytest.raises(LitheError, match="a picture is a .png or a .svg"):
        incident.plot(tmp_path / "0002.npy", tmp_path / "picture.foo")
