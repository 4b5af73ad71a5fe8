# SPDX-License-Identifier: Apache-2.0
"""`lithe bus plan` on paper, and what `lithe run` makes of a robot that its buses cannot carry."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from system.robot_rig import BIN, ROOT, RobotRig, need

ROBOTS = ROOT / "robots"


def plan(code: int, *words: object) -> dict[str, Any]:
    """One JSON document, and the exit code it came with."""
    need("lithe")
    done = subprocess.run(
        [BIN / "lithe", "--json", "bus", "plan", *map(str, words)], capture_output=True, text=True, check=False
    )
    assert done.returncode == code, done.stdout + done.stderr
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def crowded(path: Path, drives: int) -> Path:
    """A robot with so many moteus on one CAN interface, which is not there."""
    head = (ROBOTS / "arm8.toml").read_text().split("[[bus]]")[0].replace('law = "../laws/pd.cpp"', "")
    bus = '[[bus]]\nname = "can0"\nkind = "socketcan"\ninterface = "lithe-none"\n'
    devices = "".join(f'[[device]]\nname = "d{each}"\nid = {each}\n' for each in range(1, drives + 1))
    joints = "".join(f'[[joint]]\nname = "j{each}"\ndevice = "d{each}"\n' for each in range(1, drives + 1))
    path.write_text(head + bus + devices + joints)
    return path


@pytest.mark.parametrize("name", ["arm", "quadruped", "frankenstein"])
def test_the_robots_at_hand_fit_and_say_how_busy_their_buses_are(name: str, tell: Callable[[str], None]) -> None:
    answer = plan(0, ROBOTS / f"{name}.toml")
    assert answer["fits"] and answer["advice"] == []
    for bus in answer["buses"]:
        assert 0 < bus["load_average"] < bus["load_worst"] <= 0.8 and not bus["real"]
    loads = ", ".join(f"{bus['name']} {100 * bus['load_worst']:.0f} %" for bus in answer["buses"])
    tell(f"{answer['rate_hz']:g} Hz: {loads}; highest {answer['highest_rate_hz']:.0f} Hz")


def test_what_does_not_fit_exits_with_1_and_names_a_rate_that_does() -> None:
    answer = plan(1, ROBOTS / "arm8.toml")
    assert not answer["fits"] and answer["advice"]
    assert plan(0, ROBOTS / "arm8.toml", "--rate", int(answer["highest_rate_hz"]))["fits"]
    assert plan(1, ROBOTS / "quadruped.toml", "--rate", 2000)["rate_hz"] == 2000


def test_wrong_words_and_wrong_files_exit_with_2(tmp_path: Path) -> None:
    assert plan(2, tmp_path / "absent.toml")["error"]["code"] == "bad_config"
    for words in (["bus"], ["bus", "plan"], ["bus", "plan", str(ROBOTS / "arm.toml"), "--rate", "-1"]):
        assert subprocess.run([BIN / "lithe", *words], capture_output=True, check=False).returncode == 2


def test_people_read_a_table() -> None:
    done = subprocess.run(
        [BIN / "lithe", "bus", "plan", ROBOTS / "frankenstein.toml"], capture_output=True, text=True, check=True
    )
    assert "can2         loop *" in done.stdout and "column_drive" in done.stdout
    assert "planned as the CAN bus that it stands for" in done.stdout
    assert "command 48, answer 24" in done.stdout


def test_a_run_is_refused_when_a_real_bus_would_need_more_than_all_its_time(rig: RobotRig, tmp_path: Path) -> None:
    rig.config = crowded(tmp_path / "crowded.toml", 5)
    process = rig.run("--json", wait=False)
    assert process.wait(30) == 1
    log = rig.log()
    assert "125 % busy at 1000 Hz" in log and "lithe bus plan" in log and '"bus_overload"' in log
