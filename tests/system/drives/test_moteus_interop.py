# SPDX-License-Identifier: Apache-2.0
"""The maker's unmodified Python library and tool against our simulated drives, over a terminal.

1.0.0 sends checksums to everything that is no USB adapter, and drops lines that have none; 0.3.77 knows no checksums.
"""

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from system.pypi import ROOT, Package
from system.simulated import Simulated

VERSIONS = ["moteus==1.0.0", "moteus==0.3.77"]
CLIENT = Path(__file__).with_name("moteus_client.py")


@pytest.fixture(scope="module", params=VERSIONS)
def moteus(request: pytest.FixtureRequest) -> Package:
    """One version of the library."""
    return Package(request.param)


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[Simulated]:
    """The arm's one drive, served."""
    served = Simulated(ROOT / "robots" / "arm.toml", tmp_path)
    yield served
    assert served.close() == 0


def run(moteus: Package, *words: str | Path) -> subprocess.CompletedProcess[str]:
    """Python with that library, to its end."""
    command = moteus.command(*words)
    return subprocess.run(command, check=False, env=moteus.env, capture_output=True, text=True, timeout=60)


def controlled(moteus: Package, arm: Simulated) -> dict[str, Any]:
    """What the library's controller saw of the arm's drive."""
    ran = run(moteus, CLIENT, str(arm.path()), "1")
    assert ran.returncode == 0, ran.stdout + ran.stderr
    seen: dict[str, Any] = json.loads(ran.stdout)
    return seen


def tool(moteus: Package, path: Path, *words: str) -> str:
    """`moteus_tool` to its end; what it printed."""
    transport = ["--force-transport", "fdcanusb", "--fdcanusb", str(path)]
    for _ in range(10):
        ran = run(moteus, "-m", "moteus.moteus_tool", *transport, *words)
        # An answer came later than it waits: a process stood still. Whatever it does can be done again.
        if "lost synchronization" not in ran.stderr:
            break
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout


def test_the_librarys_controller_moves_the_arm(moteus: Package, arm: Simulated) -> None:
    seen = controlled(moteus, arm)
    assert seen["id"] == 1
    assert seen["modes"] == [0, 10, 0]
    assert seen["faults"] == [0, 0, 0]
    assert seen["voltage"] == 24.0
    assert abs(seen["start"]) < 0.01
    for goal, reached in zip(seen["goals"], seen["reached"], strict=True):
        assert abs(reached - goal) < 0.03, seen  # gravity pulls against a proportional gain of 4 Nm a turn


def test_the_tool_finds_the_drive_and_tells_who_it_is(moteus: Package, arm: Simulated) -> None:
    told = json.loads(tool(moteus, arm.path(), "-t", "1", "--info"))
    assert len(told["uuid"]) == 36
    assert len(told["serial_number"]) == 16
    if "1.0.0" in moteus.folder.name:  # without an id: by discovery; older ones try every id there is
        assert "can_id=1" in tool(moteus, arm.path(), "--stop")


def test_the_tool_dumps_changes_and_stores_settings(moteus: Package, arm: Simulated, tmp_path: Path) -> None:
    def dump() -> dict[str, str]:
        lines = tool(moteus, arm.path(), "-t", "1", "--dump-config").splitlines()
        return dict(line.split(" ", 1) for line in lines if " " in line)

    settings = dump()
    assert settings["id.id"] == "1"
    assert float(settings["servo.pid_position.kp"]) == 4.0
    wanted = tmp_path / "settings.cfg"
    wanted.write_text("servo.pid_position.kp 3.5\nservopos.position_max 0.5\n")
    tool(moteus, arm.path(), "-t", "1", "--restore-config", str(wanted))
    assert arm.order(fault="reset") == {"ok": True}
    assert dump() == settings | {"servo.pid_position.kp": "3.500000", "servopos.position_max": "0.500000"}


def test_the_tool_reads_records_and_stops(moteus: Package, arm: Simulated) -> None:
    tool(moteus, arm.path(), "-t", "1", "--stop")
    if "1.0.0" not in moteus.folder.name:
        return  # 0.3.77 has no --read
    stats = json.loads(tool(moteus, arm.path(), "-t", "1", "--read", "servo_stats"))
    assert stats["mode"] == 0 and stats["fault"] == 0
    assert stats["bus_V"] == 24.0
    firmware = json.loads(tool(moteus, arm.path(), "-t", "1", "--read", "firmware"))
    assert firmware["version"] == 0x010000


def test_the_library_sees_the_faults_that_are_ordered(moteus: Package, arm: Simulated) -> None:
    arm.path()
    assert arm.order(fault="over_temperature", device="shoulder_drive") == {"ok": True}
    seen = controlled(moteus, arm)
    assert seen["modes"] == [0, 1, 0]
    assert seen["faults"] == [0, 38, 0]


def test_a_wire_that_carries_nothing_is_not_taken_for_success(moteus: Package, arm: Simulated) -> None:
    path = arm.path()
    assert tool(moteus, path, "-t", "1", "--info"), "it can be started, and there is a drive"
    assert arm.order(fault="drop", share=1) == {"ok": True}
    transport = ["--force-transport", "fdcanusb", "--fdcanusb", str(path)]
    command = moteus.command("-m", "moteus.moteus_tool", *transport, "-t", "1", "--info")
    try:
        ran = subprocess.run(command, check=False, env=moteus.env, capture_output=True, timeout=3)
    except subprocess.TimeoutExpired:
        return  # it waits for ever
    assert ran.returncode != 0
