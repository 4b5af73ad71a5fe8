# SPDX-License-Identifier: Apache-2.0
"""Why a drive is not ready, from its own words to the operator: a robot whose drive is the package `canopen`."""

import contextlib
from collections.abc import Iterator
from typing import Any

import canopen
import pytest
from system.drives.canopen_peers import NODE, ROBOT
from system.drives.canopen_rig import JoinedTerminals, ThirdPartyDrive, network_on
from system.robot_rig import ROOT, RobotRig

# The other side is Python: a drive is lost after half a second without an answer.
TEXT = ROBOT.replace('name = "one"', f'name = "arm"\nlaw = "{ROOT / "laws" / "pd.cpp"}"')
TEXT = TEXT.replace(
    "[[bus]]", '[spine]\nrelease = "sleep"\nlate_ticks_to_stop = 10000\n[guard]\nlost_after_misses = 100\n[[bus]]'
)


class KeepsMode(ThirdPartyDrive):
    """It takes every mode and shows none."""

    def on_write(self, index: int, subindex: int, od: object, data: bytes) -> None:
        """6061h stays."""


class Lacks1600(ThirdPartyDrive):
    """The package needs that object itself: it has it, and tells others that there is none."""

    def on_read(self, index: int, subindex: int, od: object) -> None:
        """Refuse it."""
        if index == 0x1600:
            raise canopen.SdoAbortedError(0x06020000)

    def on_write(self, index: int, subindex: int, od: object, data: bytes) -> None:
        """Refuse it."""
        self.on_read(index, subindex, od)
        super().on_write(index, subindex, od, data)

    def boot(self) -> None:
        """From the first boot on."""
        self.node.add_read_callback(self.on_read)
        super().boot()


class CountsInRpm(ThirdPartyDrive):
    """It turns by itself with 2,000 counts a second, and gives the turns of a minute."""

    def move(self, told: dict[int, int]) -> None:
        """A period of 5 ms."""
        self.position += 10
        self.velocity = 2000 / self.COUNTS * 60


class LosesPower(ThirdPartyDrive):
    """Its heartbeat ends, and it never boots again."""

    def lose(self) -> None:
        """From now on."""
        self.node.nmt.stop_heartbeat()
        self.network.unsubscribe(0x000, self.on_nmt)
        self.network.unsubscribe(0x080, self.on_sync)
        self.node.remove_network()


@contextlib.contextmanager
def robot_with(kind: type[ThirdPartyDrive], **drive: Any) -> Iterator[tuple[RobotRig, ThirdPartyDrive]]:
    """A robot file whose one drive is that; nothing runs yet."""
    line = JoinedTerminals()
    try:
        with network_on(line.paths[1]) as network, RobotRig() as rig:
            theirs = kind(network, NODE, **drive)
            rig.config = rig.dir / "arm.toml"
            rig.config.write_text(TEXT.replace("/dev/null", line.paths[0]), encoding="utf-8")
            yield rig, theirs
    finally:
        line.close()


def told_everywhere(rig: RobotRig, words: tuple[str, ...]) -> None:
    """The same words in status, its alarms, the events and the refusal of `arm`."""

    def has_all(text: str) -> bool:
        return all(word in text for word in words)

    rig.wait_for(lambda: has_all(rig.ask("status")["not_ready"]))
    assert has_all(str(rig.ask("status")["alarms"]))
    assert has_all(str([each for each in rig.ask("events")["events"] if each["kind"] == "drives"]))
    refused = rig.lithe("arm")  # 1: not ready, 3: it has stopped
    assert refused.returncode != 0 and has_all(refused.stdout + refused.stderr), refused


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seconds until the package notices that it is to end."""
    monkeypatch.setattr(canopen.Network, "NOTIFIER_CYCLE", 0.05)


@pytest.mark.parametrize(
    ("kind", "drive", "words"),
    [
        (ThirdPartyDrive, {"values": {0x6076: 640}}, ("6076h:00 = 640 mNm", "500 mNm")),
        (ThirdPartyDrive, {"values": {0x6502: 1}}, ("6502h", 'mode = "torque"')),
        (Lacks1600, {}, ("1600h", "no such object")),
        (Lacks1600, {"without": (0x1016, 0x605A)}, ("1016h", "it lacks 605Ah, 1600h, too")),
        (ThirdPartyDrive, {"without": (0x1016, 0x6071)}, ("1016h", "it lacks 6071h, too")),
        (
            ThirdPartyDrive,
            {"values": {0x6076: 640}, "without": (0x6007,)},
            ("6076h:00 = 640 mNm", "it lacks 6007h, too"),
        ),
    ],
)
def test_what_can_be_read_is_told_by_scan_and_by_the_robot(
    kind: type[ThirdPartyDrive], drive: dict[str, Any], words: tuple[str, ...]
) -> None:
    with robot_with(kind, **drive) as (rig, _):
        for _ in range(2):  # a scan changes nothing
            scan = rig.ask("bus", "scan", rig.config, "--listen", "1.0", code=1)
            device = scan["buses"][0]["devices"][0]
            assert device["standing"] == "unfit"
            assert all(word in device["advice"] for word in words), device
        rig.run("--no-arm")
        told_everywhere(rig, words)


@pytest.mark.parametrize(
    ("kind", "words"), [(KeepsMode, ("6061h", "stays at 0")), (CountsInRpm, ("606Ch is 0.0", "counts per second"))]
)
def test_what_shows_only_in_operation_is_told_by_the_robot(kind: type[ThirdPartyDrive], words: tuple[str, ...]) -> None:
    with robot_with(kind) as (rig, _):
        said = rig.lithe("bus", "scan", rig.config, "--listen", "1.0")
        assert (said.returncode, "all that a scan can read is as" in said.stdout) == (0, True), said.stdout
        rig.run("--no-arm")
        told_everywhere(rig, words)


def test_a_drive_whose_power_is_lost_is_told() -> None:
    with robot_with(LosesPower) as (rig, theirs):
        rig.run()
        rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
        assert isinstance(theirs, LosesPower)
        theirs.lose()
        told_everywhere(rig, ("drive 'drive'", "power"))
        assert rig.ask("status")["mode"] == "safe_stop"


def test_a_module_that_is_silent_is_told_beside_its_sensors() -> None:
    with robot_with(ThirdPartyDrive) as (rig, _):
        silent = """
[[device]]
name = "inputs"
kind = "cia401"
bus = "can0"
id = 9
[[sensor]]
name = "door"
device = "inputs"
kind = "digital"
channel = 2
"""
        rig.config.write_text(rig.config.read_text().replace("[[joint]]", silent + "[[joint]]"), encoding="utf-8")
        device = rig.ask("bus", "scan", rig.config, "--listen", "1.0", code=1)["buses"][0]["devices"][1]
        assert (device["name"], device["standing"]) == ("inputs", "missing")
        rig.run("--no-arm")
        rig.wait_for(lambda: "device 'inputs'" in rig.ask("status")["not_ready"])
        status = rig.ask("status")
        assert status["sensors"]
        assert "check power, wires and its id" in str(status["alarms"])
