# SPDX-License-Identifier: Apache-2.0
"""The computer dies while the arm is held up: whole processes are killed, and the drive is alone."""

import json
import math
import os
import signal
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import calm
import pytest
from calm import connected
from system.drives.test_sim import QUERY, Wire
from system.robot_rig import ROOT, RobotRig
from system.simulated import Simulated

PATIENT = "lost_after_misses = 2000 "  # the simulated drive is a process among others here
WATCHDOG_S = 1.0
MOVES_RAD_S = 0.3
MOST_S = 30.0  # what swings freely does so for long
SAFE_KD, MGL_NM, INERTIA = 0.04, 0.165, 2.55e-3  # robots/arm.toml
CARRIES_RAD_S = MGL_NM / SAFE_KD  # how fast it sinks when damping carries all of its weight
FALLS_RAD_S = math.sqrt(2 * MGL_NM / INERTIA)  # at the bottom, from level, if nothing brakes it
LET_GO = b"can send 8001 01000011001F01130D BF\n"


class Drive:
    """The drive as a bystander sees it: by queries, which command nothing."""

    def __init__(self, path: Path) -> None:
        """Opens its terminal beside whoever else has it open."""
        self.wire = Wire(path)

    def seen(self, line: bytes = QUERY) -> tuple[int, float, float]:
        """Its mode, angle [rad] and speed [rad/s]."""
        end = time.monotonic() + 20
        while time.monotonic() < end:
            for answer in self.wire.say(line, b"\n").splitlines():
                words = answer.split()
                if len(words) > 2 and words[0] == b"rcv" and words[2].upper().startswith(b"2100"):
                    data = bytes.fromhex(words[2].decode())
                    position, velocity = struct.unpack_from("<ff", data, 5)
                    return data[2], position * math.tau, velocity * math.tau
        raise AssertionError("the drive does not answer")

    def peak_until_rest(self, line: bytes = QUERY) -> tuple[float, list[int]]:
        """The highest speed until it has rested for three seconds, and the modes that were seen."""
        peak, modes = 0.0, []
        began = moved = time.monotonic()
        # Simulated time is slow on a busy machine: it may take long to begin, and to end.
        while (now := time.monotonic()) < began + MOST_S and (peak < MOVES_RAD_S or now < moved + 3.0):
            mode, _, speed = self.seen(line)
            peak = max(peak, abs(speed))
            if abs(speed) > MOVES_RAD_S:
                moved = now
            if mode not in modes:
                modes.append(mode)
        return peak, modes


@pytest.fixture
def sim(tmp_path: Path) -> Iterator[Simulated]:
    """The arm's drive, in a process of its own."""
    with Simulated(ROOT / "robots/arm.toml", tmp_path / "buses") as served:
        yield served


def held_level(rig: RobotRig, sim: Simulated, monkeypatch: pytest.MonkeyPatch) -> None:
    """The arm, level, held up by its law."""
    changes = {
        'kind = "loop" ': f'kind = "fdcanusb"\nchecksums = "off"\npath = "{sim.path()}" ',
        "lost_after_misses = 3 ": PATIENT,
        "watchdog_s = 0.2 ": f"watchdog_s = {WATCHDOG_S} ",
    }
    rig.config.write_text(calm.calm_text(changes), encoding="utf-8")
    for key in ("LITHE_RUN_DIR", "LITHE_SHM_PREFIX", "LITHE_OUT_DIR"):
        monkeypatch.setenv(key, rig.env[key])
    process = rig.run()
    rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
    with connected() as robot:
        robot.go_to([math.pi / 2], in_s=1.0)
        rig.wait_for(lambda: abs(rig.ask("status")["joints"][0]["position_rad"] - math.pi / 2) < 0.2)
        time.sleep(0.5)
    spine = rig.ask("status")["spine_pid"]
    os.kill(process.pid, signal.SIGKILL)  # so that nobody is left who could tidy up
    os.kill(spine, signal.SIGKILL)


def test_a_dead_computers_arm_sinks_damped(
    rig: RobotRig, sim: Simulated, monkeypatch: pytest.MonkeyPatch, tell: Callable[[str], None]
) -> None:
    held_level(rig, sim, monkeypatch)
    drive = Drive(sim.path())
    mode, angle, _ = drive.seen()
    assert mode in (10, 11) and angle > 1.0, "still up"
    peak, modes = drive.peak_until_rest()
    assert modes[-1] == 11, "its watchdog has run out, and nobody woke it"
    tell(
        f"peak {peak:.2f} rad/s; damping carries the weight at {CARRIES_RAD_S:.2f}, free fall ends at {FALLS_RAD_S:.2f}"
    )
    assert peak < CARRIES_RAD_S
    assert abs(drive.seen()[1]) < 0.3, "it hangs"
    drive.wire.close()


def test_the_control_an_arm_that_is_let_go_falls(
    rig: RobotRig, sim: Simulated, monkeypatch: pytest.MonkeyPatch, tell: Callable[[str], None]
) -> None:
    held_level(rig, sim, monkeypatch)
    drive = Drive(sim.path())
    drive.seen(LET_GO)
    peak, modes = drive.peak_until_rest()
    assert modes[-1] == 0
    tell(f"peak {peak:.2f} rad/s")
    assert peak > 2 * CARRIES_RAD_S
    drive.wire.close()


@pytest.mark.parametrize(
    ("mode", "says"),
    [
        (0, "the joint would fall when this computer dies; set servo.timeout_mode to 12"),
        (10, "when this computer dies, the drive would go on and hold the joint with its own gains, without a limit"),
    ],
)
def test_a_drive_that_would_let_go_or_go_on_is_not_armed(rig: RobotRig, sim: Simulated, mode: int, says: str) -> None:
    """And the refusal says which drive, which value, and what to do; with the robot file's leave it may hold."""
    line = b"conf set servo.timeout_mode %d\n" % mode
    frame = (b"\x40\x01" + bytes([len(line)]) + line).ljust(48, b"\x50")
    wire = Wire(sim.path())
    assert b"rcv" in wire.say(b"can send 8001 %s BF\n" % frame.hex().upper().encode(), b"rcv")
    wire.close()
    changes = {
        'kind = "loop" ': f'kind = "fdcanusb"\nchecksums = "off"\npath = "{sim.path()}" ',
        "lost_after_misses = 3 ": PATIENT,
    }
    rig.config.write_text(calm.calm_text(changes), encoding="utf-8")
    rig.run("--no-arm")
    rig.wait_for(lambda: "not_ready" in rig.ask("status")["joints"][0]["problems"])
    rig.wait_for(lambda: f"servo.timeout_mode is {mode}: {says}" in rig.log())
    told = f"joint shoulder (drive shoulder_drive): servo.timeout_mode is {mode}: {says}"
    error = rig.ask("arm", code=1)["error"]
    while "is being set up" in error["message"]:  # it is asked for its settings again now and then
        error = rig.ask("arm", code=1)["error"]
    assert error["code"] == "refused_not_ready" and told in error["message"], json.dumps(error)
    assert "conf set" in error["message"] and "lithe arm" in error["next"]
    if mode == 0:
        return
    rig.ask("stop")
    assert rig.started[-1].wait(30) == 0
    rig.config.write_text(calm.calm_text(changes | {"may_hold_alone = false ": "may_hold_alone = true "}))
    rig.run()
    rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
