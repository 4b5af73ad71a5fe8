# SPDX-License-Identifier: Apache-2.0
"""Our SocketCAN bus, and a robot on three of them, on interfaces of a real kernel's, in a machine of its own. Skipped,
with the reason, where none can be booted."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from vm import machine, vcan

OF_CAN0 = {"shoulder", "upper_arm", "elbow"}


@pytest.fixture(scope="module")
def kernel() -> machine.Kernel:
    """Something to boot, and something to run there."""
    reason = vcan.why_not()
    found = vcan.find_kernel()
    if reason or found is None:
        pytest.skip(reason)
    return found


@pytest.fixture(scope="module")
def steps(kernel: machine.Kernel) -> dict[str, machine.Step]:
    """What tools/vm/vcan.sh did, each step ended as it must."""
    said = machine.boot(kernel, vcan.cargo(), vcan.CACHE)
    assert machine.wrong_steps(said, vcan.SCRIPT, vcan.REFUSED) == [], said
    return machine.steps(said)


def document(step: machine.Step) -> Any:
    """The one JSON document that a step printed."""
    return json.loads(step.text)


def standings(step: machine.Step) -> dict[tuple[str, int], tuple[str, str]]:
    """How each device of a scan stands, with the kind it was asked as, by bus and id."""
    buses = document(step)["buses"]
    return {(bus["name"], each["id"]): (each["kind"], each["standing"]) for bus in buses for each in bus["devices"]}


def problems(step: machine.Step) -> dict[str, list[str]]:
    """What `lithe status` says of each joint."""
    return {joint["name"]: joint["problems"] for joint in document(step)["joints"]}


def buses(step: machine.Step) -> dict[str, dict[str, Any]]:
    """Its counts of each bus."""
    return {bus["name"]: bus for bus in document(step)["buses"]}


def test_frames_pass_on_a_real_interface(
    kernel: machine.Kernel, steps: dict[str, machine.Step], tell: Callable[[str], None]
) -> None:
    """Classic and FD, errors, down and up, gone and back: spine/hal/bus/socketcan/test/socketcan_interface_test.cpp."""
    said = steps["program"].text
    assert "[  PASSED  ]" in said and "SKIPPED" not in said, said
    tell(f"{said.count('[       OK ]')} tests on a vcan of {kernel.image.name}")


def test_a_scan_finds_simulated_devices_behind_real_interfaces(steps: dict[str, machine.Step]) -> None:
    found = standings(steps["scan"])
    moteus = {("can0", 1), ("can0", 2), ("can0", 3), ("can1", 1), ("can1", 2)}
    assert {place for place, what in found.items() if what == ("moteus", "expected")} == moteus
    assert {place for place, what in found.items() if what == ("cia402", "expected")} == {("can2", 1), ("can2", 2)}
    assert found["can1", 20] == ("gateway", "expected")
    assert len(found) == 8 and document(steps["scan"])["matches"]
    assert [bus["place"] for bus in document(steps["scan"])["buses"]] == [f"socketcan:vcan{i}" for i in (1, 2, 3)]


def test_a_scan_names_what_is_missing_and_what_has_another_id(steps: dict[str, machine.Step]) -> None:
    assert standings(steps["scan-less"])["can1", 2] == ("moteus", "missing")
    assert [bus["matches"] for bus in document(steps["scan-less"])["buses"]][1] is False
    wrong = standings(steps["scan-wrong"])
    assert wrong["can0", 9] == ("moteus", "missing") and wrong["can0", 3] == ("moteus", "unknown")


def test_a_spine_drives_the_devices_and_no_drive_is_lost(
    steps: dict[str, machine.Step], tell: Callable[[str], None]
) -> None:
    assert not any(problems(steps["well"]).values()) and len(problems(steps["well"])) == 7
    assert document(steps["well"])["mode"] == "disarmed"
    before, after = buses(steps["well"]), buses(steps["well-still"])
    assert set(after) == {"can0", "can1", "can2"}
    for name, bus in after.items():
        assert bus["sent"] > before[name]["sent"] and bus["received"] > before[name]["received"], name
        assert (bus["refused"], bus["malformed"], bus["errors"], bus["reopened"]) == (0, 0, 0, 0), name
    assert document(steps["scan-beside"])["error"]["code"] == "robot_running"
    tell(", ".join(f"{name}: {bus['sent']} frames out, {bus['received']} in" for name, bus in after.items()))


def test_a_monitor_beside_the_spine_tells_frames_of_every_kind(steps: dict[str, machine.Step]) -> None:
    lines = [json.loads(line) for line in steps["monitor"].text.splitlines() if line]
    frames, statistics = lines[:-1], lines[-1]["statistics"]
    assert len(frames) == 120
    said = {bus: [each["says"] for each in frames if each["bus"] == bus] for bus in ("can0", "can1", "can2")}
    assert any("read mode" in says for says in said["can0"])
    assert any(says.startswith("mode stopped; position ") for says in said["can0"])
    assert any(says.startswith("analog ") for says in said["can1"])
    assert any(says.startswith("SYNC") for says in said["can2"]), said["can2"]
    assert {each["device"] for each in frames if each["bus"] == "can2"} >= {"column_drive", "boom_drive"}
    assert {each["direction"] for each in frames} == {"in", "out"}
    assert all(bus["in"] > 0 and bus["out"] > 0 and bus["errors"] == 0 for bus in statistics["buses"])


def test_an_interface_that_goes_down_is_named_and_what_was_lost_comes_back(steps: dict[str, machine.Step]) -> None:
    assert {name for name, what in problems(steps["lost"]).items() if "lost" in what} >= OF_CAN0
    assert not any(problems(steps["back"]).values())
    assert {name: bus["reopened"] for name, bus in buses(steps["back"]).items()} == {"can0": 1, "can1": 0, "can2": 0}
    log = steps["run-log"].text
    down = log.find("vcan1: is down: sudo ip link set vcan1 up")
    assert down >= 0 and "all buses and drives are well" in log[down:], log
    assert "vcan2: " not in log and "vcan3: " not in log, log
    places = [f"can{i} socketcan vcan{i + 1}" for i in range(3)]
    assert steps["sim-log"].text.split("\n")[1:-1] == [*places, "can0 socketcan unplugged", places[0]]


def test_a_program_that_fails_there_fails_here(kernel: machine.Kernel, tmp_path: Path) -> None:
    """The twin: what comes out of the machine is the program's own verdict."""
    script = tmp_path / "script.sh"
    script.write_text("step good sh -c 'exit 0'\nstep bad no_such_program\n")
    said = machine.boot(kernel, machine.Cargo(script), vcan.CACHE)
    assert machine.steps(said)["good"].code == 0, said
    assert machine.wrong_steps(said, script) == ["bad"]


def test_a_step_that_ended_otherwise_or_never_is_named() -> None:
    """The twin of the robot's steps."""

    def wrong(said: str) -> list[str]:
        return machine.wrong_steps(said, vcan.SCRIPT, vcan.REFUSED)

    names = wrong("")
    assert {"scan", "lost", "sim-log"} <= set(names)
    right = "".join(f"vm: begin {name}\r\nwords\r\nvm: end {name} {int(name in vcan.REFUSED)}\r\n" for name in names)
    assert wrong(right) == []
    assert machine.steps(right)["scan"] == machine.Step(0, "\nwords\n")
    assert wrong(right.replace("end scan-less 1", "end scan-less 0")) == ["scan-less"]
    assert wrong(right.replace("vm: end back 0\r\n", "")) == ["back"]


def test_what_is_missing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the command that brings it."""
    monkeypatch.setattr(vcan.platform, "machine", lambda: "x86_64")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "tools/setup vcan" in vcan.why_not()
    for tool in (machine.AMD64.qemu, "busybox"):
        (tmp_path / tool).touch(mode=0o755)
    assert "tools/vm/vcan.py --fetch" in vcan.why_not(tmp_path)
    monkeypatch.setattr(vcan.platform, "machine", lambda: "aarch64")
    assert "aarch64" in vcan.why_not()


def test_modules_are_loaded_after_those_they_need(tmp_path: Path) -> None:
    """As their own files say."""
    for name, needed in {"vcan": b"can_dev", "can-dev": b"", "can-raw": b"can", "can": b""}.items():
        file = tmp_path / "k/lib/modules/6/kernel" / f"{name}.ko"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(b"ELF\0license=GPL\0depends=" + needed + b"\0")
    (tmp_path / "k/boot").mkdir()
    (tmp_path / "k/boot/vmlinuz-6").touch()
    found = vcan.find_kernel(tmp_path)
    assert found is not None
    assert found.with_needed(vcan.MODULES) == ["can", "can-raw", "can_dev", "vcan"]
