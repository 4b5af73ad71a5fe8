# SPDX-License-Identifier: Apache-2.0
"""Parameters pass the trial as laws do, prove themselves in motion, and come with their law on its first tick."""

import os
from collections.abc import Callable
from typing import Any

from calm import calm_text, connected
from system.robot_rig import RobotRig
from system.swapping import becomes, certificate, certificates, sway


def in_force(rig: RobotRig, name: str) -> float:
    """The value of a parameter now."""
    return float(rig.ask("param", "get", name)["params"][0]["value"])


def changes(rig: RobotRig) -> list[dict[str, Any]]:
    """What the certificate of the newest law says of its parameters."""
    found: list[dict[str, Any]] = certificates(rig)[-1].get("param_changes", [])
    return found


def test_a_stiffness_that_shakes_the_chain_is_refused_as_parameter_and_as_swap(
    rig: RobotRig, tell: Callable[[str], None]
) -> None:
    """kp 40: the wrist swung at 18 rad/s when parameters were not tried."""
    rig.config.write_text(calm_text(robot="chain"))
    rig.run()
    rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
    error = rig.ask("param", "set", "kp_nm_rad=40", code=1)["error"]
    tell(error["message"])
    assert error["code"] == "trial_failed" and error["message"].startswith("kp_nm_rad = 40 (now 4): loop: ")
    assert "joint " in error["message"] and " rad/s" in error["message"]
    assert "nothing was changed" in error["next"]
    assert in_force(rig, "kp_nm_rad") == 4.0
    assert [each["kind"] for each in rig.ask("events")["events"]].count("params_applied") == 0
    last = rig.ask("status")["last_params"]
    assert (last["law"], last["verdict"], last["values"]) == ("pd", "refused", {"kp_nm_rad": 40.0})
    assert [each["verdict"] for each in changes(rig)] == ["refused"]
    assert "kp_nm_rad = 40.0 refused: " in rig.lithe("status").stdout
    as_swap = rig.ask("swap", "pd", "--param", "kp_nm_rad=40", code=1)["error"]
    assert as_swap["code"] == "trial_failed" and as_swap["message"] in error["message"]


def test_good_parameters_are_unproven_at_rest_and_confirmed_in_motion(
    arm: RobotRig, tell: Callable[[str], None]
) -> None:
    """The law's certificate and the status say what became of them."""
    answer = arm.ask("param", "set", "kp_nm_rad=5")
    tell(f"tried in {answer['trial_ms']:.0f} ms")
    assert in_force(arm, "kp_nm_rad") == 5.0 and answer["warnings"] == []
    arm.wait_for(lambda: arm.ask("status")["last_params"]["verdict"] == "unproven")
    assert arm.ask("status")["probation"] == {"of": "params", "unproven": True}
    assert "on probation: its parameters, unproven" in arm.lithe("status").stdout
    assert changes(arm)[-1]["before"] == {"kp_nm_rad": 4.0}
    sway(arm)
    arm.wait_for(lambda: changes(arm)[-1]["verdict"] == "confirmed")
    assert arm.ask("status")["last_params"]["verdict"] == "confirmed"
    assert arm.ask("status")["probation"] == {"of": "none", "unproven": False}
    assert "params set    kp_nm_rad 5 confirmed" in arm.lithe("law", "show", "last").stdout


def test_a_law_at_rest_is_unproven_until_it_has_moved(arm: RobotRig) -> None:
    """In its certificate and in the status."""
    done = arm.ask("swap", "gravity_pd", "--probation", "200ms")
    assert done["verdict"] == "committed"
    told = becomes(arm, done["request_id"], lambda each: each["verdict"] == "unproven")
    assert "moved too little" in told["reasons"]["unproven"]
    status = arm.ask("status")
    assert status["last_swap"]["verdict"] == "unproven" and "moved too little" in status["last_swap"]["reason"]
    assert status["probation"] == {"of": "law", "unproven": True}
    assert "unproven: the robot has moved too little to judge by" in arm.lithe("law", "show", "last").stdout
    sway(arm)
    becomes(arm, done["request_id"], lambda each: each["verdict"] == "confirmed")
    assert arm.ask("status")["last_swap"]["verdict"] == "confirmed"
    assert arm.ask("status")["probation"] == {"of": "none", "unproven": False}


SHOWS_GAIN = """
#include <lithe/law.hpp>
struct Gain {
  struct Params {
    lithe::Param gain{1.0, 0.0, 2.0};
  };
  struct State {};
  struct Probes {
    double gain = 0;
  };
  static void step(const lithe::Tick& t, const Params& p, State&, lithe::Effort& u, Probes& probes) {
    u.torque_nm[0] = -0.5 * t.position_rad[0] - 0.02 * t.velocity_rad_s[0];
    probes.gain = double(p.gain);
  }
};
LITHE_LAW(Gain, "gain");
"""


def test_the_parameters_of_a_swap_are_in_force_on_the_laws_first_tick(arm: RobotRig) -> None:
    """Not some ticks later, by a command of their own; and a revert does not lead to values that were never tried."""
    path = arm.dir / "gain.cpp"
    path.write_text(SHOWS_GAIN)
    os.environ.update({key: value for key, value in arm.env.items() if key.startswith("LITHE_")})
    with connected() as robot:
        done = arm.ask("swap", path, "--param", "gain=1.5")
        records = robot.telemetry.history(2.0)
    ours = records[records["law_id"] == done["law_id"]]
    assert len(ours) > 0 and set(ours["probe"][:, 0]) == {1.5}
    assert done["params"] == {"values": {"gain": 1.5}, "taken": True}
    arm.ask("param", "revert")
    assert in_force(arm, "gain") == 1.5


def test_a_law_that_follows_worse_than_the_running_one_comes_in_with_a_warning(arm: RobotRig) -> None:
    """Per joint, with the numbers of both; the answer, the status and the certificate say it."""
    done = arm.ask("swap", "pd", "--param", "kp_nm_rad=0.2")
    worse = [each for each in done["trial"]["warnings"] if "worse than under pd, which runs now" in each]
    assert worse and worse[0].startswith("joint shoulder follows its setpoint ") and " rad against " in worse[0]
    assert arm.ask("status")["last_swap"]["warnings"] == done["trial"]["warnings"]
    assert certificate(arm, done["request_id"])["trial"]["warnings"] == done["trial"]["warnings"]
    assert worse[0] in arm.lithe("law", "show", "last").stdout
    again = arm.ask("swap", "pd")
    assert not [each for each in again["trial"]["warnings"] if "worse" in each], "it follows better"


def test_the_law_of_a_supervisor_that_was_killed_is_tried_from_the_cache(arm: RobotRig) -> None:
    """The next supervisor never saw its swap."""
    arm.started[0].kill()
    arm.started[0].wait()
    arm.socket.unlink(missing_ok=True)
    arm.run()
    assert arm.ask("param", "set", "kp_nm_rad=5")["trial_ms"] > 0
    error = arm.ask("param", "set", "kp_nm_rad=200", "kd_nm_s_rad=0", code=1)["error"]
    assert error["code"] == "trial_failed", error
    assert in_force(arm, "kp_nm_rad") == 5.0
