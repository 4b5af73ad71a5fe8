# SPDX-License-Identifier: Apache-2.0
"""A law that returns NaN on the live robot is told its line, or why not: the trial repeats it on what was recorded."""

import platform

import pytest
from system.robot_rig import RobotRig
from system.swapping import becomes

# Fine until tick `late_after`; then 0 / 0.
LATE = """#include <lithe/law.hpp>
struct Late {
  struct Params {
    lithe::Param late_after{1e9, 0, 1e12};
  };
  struct State {};
  static void step(const lithe::Tick& t, const Params& p, State&, lithe::Effort& u) {
    const double left = std::max(0.0, p.late_after - static_cast<double>(t.tick));
    const double share = left / left;
    u.torque_nm[0] = share * (t.setpoint_position_rad[0] - t.position_rad[0]) - 0.03 * t.velocity_rad_s[0];
  }
};
LITHE_LAW(Late, "late");
"""
LINE = 1 + LATE.splitlines().index("    const double share = left / left;")


@pytest.mark.alone  # the trial looks for the line, with what the processors have to spare
def test_the_line_that_made_a_nan_on_the_live_robot_is_found(arm: RobotRig) -> None:
    """In the event, the status and the certificate; the law before it runs."""
    path = arm.dir / "late.cpp"
    path.write_text(LATE)
    arm.ask("swap", path)  # so that it is compiled: on a busy machine that takes seconds
    arm.ask("rollback")
    late_after = arm.ask("status")["tick"] + 4000
    done = arm.ask("swap", path, "--param", f"late_after={late_after}")
    stops = platform.machine() == "x86_64"
    told = becomes(
        arm, done["request_id"], lambda each: ("where" in each["fault"] or not stops) if "fault" in each else False
    )
    assert told["fault"]["kind"] == "not_finite" and told["fault"]["tick"] >= late_after
    if not stops:
        return
    assert told["fault"]["where"] == f"late.cpp:{LINE}"
    (located,) = [each for each in arm.ask("events")["events"] if each["kind"] == "law_fault_located"]
    assert f"late at late.cpp:{LINE}" in located["text"]
    assert arm.ask("status")["law_faults"][-1]["where"] == f"late.cpp:{LINE}" and arm.ask("status")["law"] == "pd"


def test_why_a_line_is_not_found_is_told(arm: RobotRig) -> None:
    """A NaN that comes with the time since the law began: the trial begins at 0 again, and has 4 s at most."""
    path = arm.dir / "timed.cpp"
    path.write_text(LATE.replace("static_cast<double>(t.tick)", "t.t_s").replace("1e9, 0", "6, 0"))
    done = arm.ask("swap", path)
    becomes(arm, done["request_id"], lambda each: "fault" in each)

    def told() -> list[str]:
        return [each["text"] for each in arm.ask("events")["events"] if each["kind"] == "law_fault_not_located"]

    arm.wait_for(lambda: bool(told()))
    assert len(told()) == 1 and told()[0].startswith("late: the line of what is not finite is not known: ")
