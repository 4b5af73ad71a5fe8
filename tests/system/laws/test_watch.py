# SPDX-License-Identifier: Apache-2.0
"""A law that was confirmed and turns bad later: what its robot, its events and its certificate say."""

import time
from typing import Any

import pytest
from calm import connected
from system.robot_rig import RobotRig
from system.swapping import becomes, certificate, law, sway

TURNS = """
#include <lithe/law.hpp>
// Good for so many steps, then with the other sign.
struct Turns {
  struct Params {
    lithe::Param after{10000, 0, 1e6};
  };
  struct State {
    std::uint32_t steps = 0;
  };
  static void step(const lithe::Tick& in, const Params& p, State& s, lithe::Effort& out) {
    const double sign = ++s.steps > p.after ? -1 : 1;
    for (std::uint32_t j = 0; j < in.joints; ++j)
      out.torque_nm[j] = sign * (4 * (in.setpoint_position_rad[j] - in.position_rad[j]) - 0.1 * in.velocity_rad_s[j]);
  }
};
LITHE_LAW(Turns, "turns");
"""


def confirmed(rig: RobotRig) -> int:
    """Swaps it in and moves until it is confirmed; the number of its request."""
    path = rig.dir / "turns.cpp"
    path.write_text(TURNS)
    done: dict[str, Any] = rig.ask("swap", path)
    sway(rig)
    assert certificate(rig, done["request_id"])["verdict"] == "confirmed"
    with connected() as robot:  # where its weight pulls: at rest at the bottom, friction alone would hold it
        robot.go_to([1.0], 1.0)
        time.sleep(1.5)
    return int(done["request_id"])


def events(rig: RobotRig, kind: str) -> list[dict[str, Any]]:
    """Those of one kind."""
    return [each for each in rig.ask("events")["events"] if each["kind"] == kind]


@pytest.mark.alone
def test_a_confirmed_law_that_turns_bad_is_taken_away_and_explained(arm: RobotRig) -> None:
    """The law before it holds the joint where it is; events and certificate name the joint and what to do."""
    request_id = confirmed(arm)
    told = becomes(arm, request_id, lambda each: each["verdict"] == "rolled_back")
    back = told["rolled_back"]
    assert back["why"].startswith("pushes_away: joint shoulder, error ") and "a sign" in back["next"], back
    assert told["suspected"]["why"].startswith("pushes_away: joint shoulder, error "), told["suspected"]
    assert told["fault"]["kind"] == "pushes_away"
    status = arm.ask("status")
    assert (law(arm), status["mode"], status["fault"], status["law_suspected"]) == ("pd", "hold", "none", None)
    (alarm,), (gone,), (held,) = (events(arm, kind) for kind in ("law_suspected", "law_rolled_back", "held"))
    assert alarm["reason"] == "pushes_away" and alarm["joint"] == gone["joint"] == "shoulder", (alarm, gone)
    assert alarm["value"] > alarm["limit"] >= 0.15 and alarm["next"] and alarm["tick"] < gone["tick"] == held["tick"]
    assert "arm follows plans again" in held["text"]
    shown = arm.lithe("law", "show", "turns").stdout
    assert "pushes_away: joint shoulder" in shown, shown
    assert arm.ask("arm")["mode"] == "active"


@pytest.mark.alone
def test_where_the_file_wants_only_an_alarm_the_law_stays(rig: RobotRig) -> None:
    """The alarm is in the status for as long as the law is bad."""
    rig.config.write_text(rig.config.read_text().replace('watch = "last_good"', 'watch = "alarm"'))
    rig.run()
    rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
    confirmed(rig)
    rig.wait_for(lambda: rig.ask("status")["law_suspected"])
    status = rig.ask("status")
    said = [each for each in status["alarms"] if each["text"].startswith("the law turns: pushes_away: joint shoulder")]
    assert len(said) == 1 and said[0]["level"] == "warn" and "; next: " in said[0]["text"], status["alarms"]
    assert law(rig) == "turns" and status["mode"] == "active"
