# SPDX-License-Identifier: Apache-2.0
"""`lithe estop` with one robot, with several, and with one of them beyond reach."""

import os
import signal
import subprocess
import sys
from pathlib import Path

from lithe._wire import SEGMENTS
from system.robot_rig import RobotRig


def estop_word(rig: RobotRig, robot: str) -> int:
    """The sticky word in a robot's control segment."""
    with Path(f"/dev/shm/{rig.prefix}.{robot}.control").open("rb") as file:
        file.seek(SEGMENTS["control"]["estop"].offset)
        return int.from_bytes(file.read(8), "little")


def second_arm(rig: RobotRig) -> None:
    """Starts another arm in the same rig."""
    text = rig.config.read_text().replace('name = "arm"', 'name = "brm"', 1)
    assert '"brm"' in text
    config = rig.dir / "brm.toml"
    config.write_text(text)
    first, rig.config = rig.config, config
    rig.run(wait=False)
    rig.config = first
    rig.wait_for(lambda: rig.lithe("--robot", "brm", "status").returncode == 0)


def mode_of(rig: RobotRig, robot: str) -> str:
    """What its status says."""
    return str(rig.ask("--robot", robot, "status")["mode"])


def test_estop_without_a_name_stops_every_robot(rig: RobotRig) -> None:
    """Both are reported, and each stays stopped until it is reset."""
    rig.run()
    second_arm(rig)
    assert "estop" not in (mode_of(rig, "arm"), mode_of(rig, "brm"))
    result = rig.ask("estop")
    assert {each["robot"]: each["mode"] for each in result["robots"]} == {"arm": "estop", "brm": "estop"}
    assert (mode_of(rig, "arm"), mode_of(rig, "brm")) == ("estop", "estop")
    assert rig.ask("--robot", "brm", "reset")["mode"] == "disarmed"
    assert mode_of(rig, "arm") == "estop"
    told = rig.lithe("estop")
    assert told.returncode == 0
    assert "arm: estop" in told.stdout and "brm: estop" in told.stdout


def test_a_robot_that_does_not_obey_keeps_no_other_from_stopping(rig: RobotRig) -> None:
    """The first in the alphabet is frozen: the second stops all the same, and the exit code says that one has not."""
    rig.run()
    second_arm(rig)
    frozen = rig.ask("--robot", "arm", "status")["spine_pid"]
    rig.freeze(frozen)
    try:
        error = rig.ask("estop", code=3)["error"]
        assert error["code"] == "robot_fault" and "1 of 2" in error["message"]
        told = {each["robot"]: each for each in error["detail"]["robots"]}
        assert told["brm"]["mode"] == "estop"
        assert "not obeyed" in told["arm"]["error"]["message"]
        assert mode_of(rig, "brm") == "estop"
        assert estop_word(rig, "arm") == 1
        spoken = rig.lithe("estop")
        assert spoken.returncode == 3 and "brm: estop" in spoken.stdout and "arm: " in spoken.stderr
    finally:
        os.kill(frozen, signal.SIGCONT)
    rig.wait_for(lambda: mode_of(rig, "arm") == "estop")


def test_the_estop_verb_presses_the_sticky_word(rig: RobotRig) -> None:
    """What comes through the socket stays pressed too; only a reset lifts it."""
    rig.run()
    assert estop_word(rig, "arm") == 0
    assert rig.raw(b'{"id":1,"verb":"estop"}\n')["result"]["mode"] == "estop"
    assert estop_word(rig, "arm") == 1
    assert rig.ask("arm", code=1)["error"]["code"] == "refused_estop"
    assert rig.ask("reset")["mode"] == "disarmed"
    assert estop_word(rig, "arm") == 0


def test_files_of_a_dead_robot_are_no_robot(rig: RobotRig) -> None:
    """Everything was killed: there is nobody to stop, and that is said."""
    process = rig.run()
    spine = rig.ask("status")["spine_pid"]
    process.kill()
    os.kill(spine, signal.SIGKILL)
    process.wait()
    rig.wait_for(lambda: rig.lithe("estop").returncode == 1)
    assert rig.segments() != []
    assert rig.ask("estop", code=1)["error"]["code"] == "no_robot"


def test_who_holds_the_estop_is_named_with_the_way_out(rig: RobotRig) -> None:
    """A Brain's word is not the supervisor's to clear: status and reset name its process."""
    rig.run()
    code = "import lithe, time; robot = lithe.connect(); robot.estop(); print(flush=True); time.sleep(600)"
    with subprocess.Popen([sys.executable, "-c", code], env=rig.env, stdout=subprocess.PIPE) as brain:
        assert brain.stdout is not None
        brain.stdout.readline()
        holder = f"pid {brain.pid} ({sys.executable} -c import lithe"
        status = rig.ask("status")
        assert status["estop_held_by"].startswith(holder)
        assert f"the e-stop is held by the Brain, {holder}" in status["alarms"][0]["text"]
        error = rig.ask("reset", code=1)["error"]
        assert error["code"] == "refused_estop" and f"held by the Brain, {holder}" in error["message"]
        assert "reset from there" in error["next"] and "end that Brain and reset again" in error["next"]
        brain.kill()
    assert rig.ask("reset")["mode"] == "disarmed"
    assert "estop_held_by" not in rig.ask("status")
