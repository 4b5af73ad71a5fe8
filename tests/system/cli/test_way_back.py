# SPDX-License-Identifier: Apache-2.0
"""From wherever verbs and a bad law bring the arm, verbs alone bring it back to its law; over the socket."""

import json
import os
import time
from random import Random
from typing import Any

import lithe
import pytest
from calm import calm_text
from system.robot_rig import ROOT, RobotRig

OUTSIDE_RAD = 3.5  # beyond the limit of 3.0 and the overrun of 0.2; gravity pulls it on


def verb(rig: RobotRig, word: str, **args: Any) -> dict[str, Any]:
    """One request on the control socket."""
    return rig.raw(json.dumps({"id": 1, "verb": word, "args": args}).encode() + b"\n")


@pytest.fixture
def outside(rig: RobotRig) -> RobotRig:
    """An arm that stands outside its limits, running."""
    text = calm_text().replace("initial_position_rad = 0.0", f"initial_position_rad = {OUTSIDE_RAD}")
    # It must not swing away while nobody holds it: friction as of a worm gear.
    text = text.replace("coulomb_nm = 0.0132", "coulomb_nm = 0.1")
    assert str(OUTSIDE_RAD) in text and "coulomb_nm = 0.1" in text
    rig.config.write_text(text)
    rig.run()
    rig.wait_for(lambda: "not armed" in rig.log())
    return rig


def test_arm_names_joint_angle_limit_and_the_way_and_recover_goes_it(outside: RobotRig) -> None:
    refused = outside.ask("arm", code=1)["error"]
    assert refused["code"] == "refused_outside"
    assert "shoulder is at 3.5" in refused["message"] and "limit is 3.000" in refused["message"]
    assert "lithe recover" in refused["next"]
    assert verb(outside, "arm")["error"]["code"] == "refused_outside"
    said = outside.lithe("recover")
    assert said.returncode == 0, said.stderr
    assert "every joint is inside" in said.stdout
    status = outside.ask("status")
    assert status["mode"] == "recover" and not status["recovering"]
    assert status["joints"][0]["position_rad"] <= 3.0
    assert outside.ask("arm")["mode"] == "active"
    assert outside.ask("status")["mode"] == "active"


def test_the_brain_recovers_it_and_sim_reset_undoes_it(outside: RobotRig) -> None:
    os.environ.update({key: outside.env[key] for key in ("LITHE_RUN_DIR", "LITHE_SHM_PREFIX")})
    cores = os.sched_getaffinity(0)
    with lithe.connect("arm", writes_plans=False) as robot:
        os.sched_setaffinity(0, cores)
        with pytest.raises(lithe.Refused) as caught:
            robot.arm()
        assert caught.value.code == "refused_outside"
        assert robot.recover()["joints"][0]["position_rad"] <= 3.0
        with pytest.raises(lithe.Refused) as caught:
            robot.sim_reset()
        assert caught.value.code == "refused_mode"
        robot.disarm()
        robot.sim_reset()
        outside.wait_for(lambda: abs(robot.status()["joints"][0]["position_rad"] - OUTSIDE_RAD) < 0.01)
        robot.recover()
        assert robot.arm()["mode"] == "active"


def test_a_joint_that_cannot_be_moved_is_named_with_the_reason(rig: RobotRig) -> None:
    text = calm_text().replace("initial_position_rad = 0.0", f"initial_position_rad = {OUTSIDE_RAD}")
    rig.config.write_text(text.replace("coulomb_nm = 0.0132", "coulomb_nm = 0.5"))  # stuck
    rig.run()
    rig.wait_for(lambda: "not armed" in rig.log())
    said = rig.lithe("recover")
    assert said.returncode == 3
    assert "recover_failed at joint shoulder: the recover torque does not move it (load, or a stop)" in said.stderr
    assert "recover_torque_share" in said.stderr
    assert rig.ask("status")["mode"] == "safe_stop"


PUSH = """#include <lithe/law.hpp>
struct Push {
  struct Params {};
  struct State {};
  static void step(const lithe::Tick&, const Params&, State&, lithe::Effort& u) { u.torque_nm[0] = 1.0; }
};
LITHE_LAW(Push, "push");
"""


def come_back(rig: RobotRig) -> None:
    """The verbs a person has, and a law that is good."""
    verb(rig, "reset")
    verb(rig, "disarm")
    assert verb(rig, "swap", source=(ROOT / "laws/pd.cpp").read_text(), name="pd.cpp", probation_s=0)["ok"]
    for _ in range(3):  # the way may need more than one verb: a joint that recover has put inside may fall out again
        if verb(rig, "arm", all_the_same=True)["ok"]:
            time.sleep(0.3)
            if rig.ask("status")["mode"] == "active":
                return
        verb(rig, "recover")
        rig.wait_for(lambda: not rig.ask("status")["recovering"], 60)
    raise AssertionError(f"no way back: {rig.ask('status')}")


def test_random_verbs_and_a_law_that_pushes_never_lead_where_verbs_do_not_lead_back(rig: RobotRig) -> None:
    random = Random(5)
    rig.run("--ungated")
    rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
    for _ in range(6):
        verb(rig, "swap", source=PUSH, name="push.cpp", probation_s=0)
        for _ in range(random.randrange(1, 6)):
            verb(rig, random.choice(["arm", "disarm", "hold", "reset", "estop", "recover", "rollback"]))
            time.sleep(random.uniform(0, 0.5))
        come_back(rig)
    assert rig.ask("status")["mode"] == "active"
