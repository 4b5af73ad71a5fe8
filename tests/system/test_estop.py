# SPDX-License-Identifier: Apache-2.0
"""`lithe estop` with one robot, with several, and with one of them beyond reach."""

import os
import signal
from pathlib import Path

from lithe._wire import SEGMENTS
from system.house import House


def estop_word(house: House, robot: str) -> int:
    """The sticky word in a robot's control segment."""
    with Path(f"/dev/shm/{house.prefix}.{robot}.control").open("rb") as file:
        file.seek(SEGMENTS["control"]["estop"].offset)
        return int.from_bytes(file.read(8), "little")


def second_arm(house: House) -> None:
    """Starts another arm in the same house."""
    text = house.config.read_text().replace('name = "arm"', 'name = "brm"', 1)
    assert '"brm"' in text
    config = house.dir / "brm.toml"
    config.write_text(text)
    first, house.config = house.config, config
    house.run(wait=False)
    house.config = first
    house.wait_for(lambda: house.lithe("--robot", "brm", "status").returncode == 0)


def mode_of(house: House, robot: str) -> str:
    """What its status says."""
    return str(house.ask("--robot", robot, "status")["mode"])


def test_estop_without_a_name_stops_every_robot(house: House) -> None:
    """Both are reported, and each stays stopped until it is reset."""
    house.run()
    second_arm(house)
    assert "estop" not in (mode_of(house, "arm"), mode_of(house, "brm"))
    result = house.ask("estop")
    assert {each["robot"]: each["mode"] for each in result["robots"]} == {"arm": "estop", "brm": "estop"}
    assert (mode_of(house, "arm"), mode_of(house, "brm")) == ("estop", "estop")
    assert house.ask("--robot", "brm", "reset")["mode"] == "disarmed"
    assert mode_of(house, "arm") == "estop"
    told = house.lithe("estop")
    assert told.returncode == 0
    assert "arm: estop" in told.stdout and "brm: estop" in told.stdout


def test_a_robot_that_does_not_obey_keeps_no_other_from_stopping(house: House) -> None:
    """The first in the alphabet is frozen: the second stops all the same, and the exit code says that one has not."""
    house.run()
    second_arm(house)
    frozen = house.ask("--robot", "arm", "status")["spine_pid"]
    house.freeze(frozen)
    try:
        error = house.ask("estop", code=3)["error"]
        assert error["code"] == "robot_fault" and "1 of 2" in error["message"]
        told = {each["robot"]: each for each in error["detail"]["robots"]}
        assert told["brm"]["mode"] == "estop"
        assert "not obeyed" in told["arm"]["error"]["message"]
        assert mode_of(house, "brm") == "estop"
        assert estop_word(house, "arm") == 1
        spoken = house.lithe("estop")
        assert spoken.returncode == 3 and "brm: estop" in spoken.stdout and "arm: " in spoken.stderr
    finally:
        os.kill(frozen, signal.SIGCONT)
    house.wait_for(lambda: mode_of(house, "arm") == "estop")


def test_the_estop_verb_presses_the_sticky_word(house: House) -> None:
    """What comes through the socket stays pressed too; only a reset lifts it."""
    house.run()
    assert estop_word(house, "arm") == 0
    assert house.raw(b'{"id":1,"verb":"estop"}\n')["result"]["mode"] == "estop"
    assert estop_word(house, "arm") == 1
    assert house.ask("arm", code=1)["error"]["code"] == "refused_estop"
    assert house.ask("reset")["mode"] == "disarmed"
    assert estop_word(house, "arm") == 0


def test_files_of_a_dead_robot_are_no_robot(house: House) -> None:
    """Everything was killed: there is nobody to stop, and that is said."""
    process = house.run()
    spine = house.ask("status")["spine_pid"]
    process.kill()
    os.kill(spine, signal.SIGKILL)
    process.wait()
    house.wait_for(lambda: house.lithe("estop").returncode == 1)
    assert house.segments() != []
    assert house.ask("estop", code=1)["error"]["code"] == "no_robot"
