# SPDX-License-Identifier: Apache-2.0
"""`lithe bus scan`: simulated devices behind real terminals, held against robot files."""

import json
import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from system.robot_rig import BIN, ROOT, RobotRig, need
from system.simulated import Simulated

ROBOTS = ROOT / "robots"
LISTEN = ("--listen", "1.0")  # beside other tests a simulated device may answer late


def on_wires(robot: str, folder: Path, kinds: dict[str, str], **words: str) -> Path:
    """The robot file with its buses on the terminals that `lithe sim` links there; more words to replace."""
    text = (ROBOTS / f"{robot}.toml").read_text().replace('law = "../laws/pd.cpp"', "")
    text = text.replace('release = "spin"', 'release = "sleep"')
    for bus, kind in kinds.items():
        head, tail = text.split(f'name = "{bus}"\n', 1)
        assert 'kind = "loop"' in tail
        tail = tail.replace('kind = "loop"', f'kind = "{kind}"\npath = "{folder / bus}"', 1)
        text = f'{head}name = "{bus}"\n{tail}'
    for old, new in words.items():
        assert old in text
        text = text.replace(old, new)
    path = folder.parent / f"{folder.name}-{robot}.toml"
    path.write_text(text)
    return path


def scan(code: int, *words: object, env: dict[str, str] | None = None) -> dict[str, Any]:
    """One JSON document, and the exit code it came with."""
    need("lithe")
    command = [BIN / "lithe", "--json", "bus", "scan", *map(str, words), *LISTEN]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ | (env or {}))
    assert done.returncode == code, done.stdout + done.stderr
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


FRANKENSTEIN = {"can0": "fdcanusb", "can1": "fdcanusb", "can2": "slcan"}


def test_two_kinds_of_drive_and_a_gateway_are_as_the_file_says(tmp_path: Path, tell: Callable[[str], None]) -> None:
    folder = tmp_path / "wires"
    file = on_wires("frankenstein", folder, FRANKENSTEIN)
    with Simulated(file, folder) as served:
        for bus in FRANKENSTEIN:
            served.path(bus)
        answer = scan(0, file)
        assert answer["matches"] and answer["robot"] == "frankenstein"
        found = {(bus["name"], each["name"]): each for bus in answer["buses"] for each in bus["devices"]}
        assert len(found) == 8 and all(each["standing"] == "expected" for each in found.values())
        assert "register map 5" in found["can0", "elbow_drive"]["says"]
        assert "profile 402" in found["can2", "boom_drive"]["says"]
        assert "analog" in found["can1", "hand_inputs"]["says"]
        one = scan(0, file, "--bus", "can2")
        assert [each["id"] for each in one["buses"][0]["devices"]] == [1, 2]
        tell(f"{len(found)} devices on 3 buses, e.g. {found['can0', 'elbow_drive']['says']}")


def test_what_is_missing_unknown_or_there_twice_is_named_with_what_to_do(tmp_path: Path) -> None:
    folder = tmp_path / "wires"
    there = on_wires("arm", folder, {"can0": "fdcanusb"})
    with Simulated(there, folder) as served:
        served.path()
        wished = there.with_name("wished.toml")
        wished.write_text(there.read_text().replace("id = 1 ", "id = 9 "))
        assert wished.read_text() != there.read_text()
        answer = scan(1, wished)
        assert not answer["matches"]
        standing = {each["id"]: each for each in answer["buses"][0]["devices"]}
        assert (standing[1]["standing"], standing[9]["standing"]) == ("unknown", "missing")
        assert "write id = 1" in standing[9]["advice"]
        people = subprocess.run(
            [BIN / "lithe", "bus", "scan", wished, *LISTEN], capture_output=True, text=True, check=False
        )
        assert people.returncode == 1 and "next:" in people.stdout and "missing" in people.stdout
        assert served.order(fault="duplicate", share=1) == {"ok": True}
        assert {each["standing"] for each in scan(1, there)["buses"][0]["devices"]} == {"twice"}
        assert served.order(fault="bus_off", on=True) == {"ok": True}
        assert "bus-off" in scan(1, there)["buses"][0]["trouble"]


def test_a_bus_without_a_file_shows_what_is_there(tmp_path: Path) -> None:
    folder = tmp_path / "wires"
    with Simulated(ROBOTS / "arm.toml", folder) as served:
        served.path()
        answer = scan(0, f"fdcanusb:{folder / 'can0'}")
        assert answer["robot"] is None
        assert [each["standing"] for each in answer["buses"][0]["devices"]] == ["present"]
    gone = scan(1, f"fdcanusb:{folder / 'can0'}")
    assert "no such device" in gone["buses"][0]["trouble"]
    assert "-DLITHE_PI3HAT=ON" in scan(1, "pi3hat:1")["buses"][0]["trouble"]


def test_beside_a_spine_nothing_is_asked(rig: RobotRig, tmp_path: Path) -> None:
    folder = tmp_path / "wires"
    rig.config = on_wires("arm", folder, {"can0": "fdcanusb"})
    with Simulated(rig.config, folder) as served:
        served.path()
        rig.run("--no-arm")
        for what in (rig.config, f"fdcanusb:{served.path().resolve()}"):
            refused = scan(1, what, env=rig.env)
            assert refused["error"]["code"] == "robot_running"
            assert "robot 'arm' (bus 'can0')" in refused["error"]["message"]
        rig.ask("stop")
        rig.wait_for(lambda: rig.started[0].poll() is not None)
        assert scan(0, rig.config, env=rig.env)["matches"]


def test_simulated_buses_have_nothing_to_find_and_wrong_words_exit_with_2(tmp_path: Path) -> None:
    answer = scan(0, ROBOTS / "arm.toml")
    told = subprocess.run(
        [BIN / "lithe", "bus", "scan", ROBOTS / "arm.toml"], capture_output=True, text=True, check=False
    )
    assert "nothing was asked" in told.stdout and "all" not in told.stdout.splitlines()[-1]
    assert "simulated" in answer["buses"][0]["note"] and answer["buses"][0]["devices"] == []
    assert scan(2, tmp_path / "absent.toml")["error"]["code"] == "bad_config"
    assert "it has can0" in scan(2, ROBOTS / "arm.toml", "--bus", "can7")["error"]["message"]
    assert subprocess.run([BIN / "lithe", "bus", "scan"], capture_output=True, check=False).returncode == 2


@pytest.mark.parametrize("words", [("pi3hat:9",), ("socketcan:can0", "--bus", "x")])
def test_buses_that_cannot_be_are_refused(words: tuple[str, ...]) -> None:
    assert scan(2, *words)["error"]["code"] == "bad_config"
