# SPDX-License-Identifier: Apache-2.0
"""`lithe bus monitor`: on a bus that nobody owns, and through the Spine that owns one."""

import json
import re
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from calm import calm_text
from system.buses.test_bus_scan import FRANKENSTEIN, ROBOTS, on_wires
from system.robot_rig import BIN, ROOT, RobotRig, need
from system.simulated import Simulated


def monitor(rig: RobotRig, *words: object, code: int = 0) -> list[dict[str, Any]]:
    """Its JSON lines; the last one has the statistics."""
    done = rig.lithe("--json", "bus", "monitor", *map(str, words))
    assert done.returncode == code, done.stdout + done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_frames_of_a_running_robot_in_memory_are_seen_both_ways(rig: RobotRig, tell: Callable[[str], None]) -> None:
    rig.run()
    lines = monitor(rig, rig.config, "--count", 400, "--seconds", 20, "--raw")
    frames, statistics = lines[:-1], lines[-1]["statistics"]
    assert len(frames) == 400
    assert {each["device"] for each in frames} == {"shoulder_drive"}
    out = [each for each in frames if each["direction"] == "out"]
    back = [each for each in frames if each["direction"] == "in"]
    assert abs(len(out) - len(back)) <= 1
    assert out[0]["says"].startswith("write mode position; write position ") and "read " in out[0]["says"]
    assert back[0]["says"].startswith("mode position; position ") and " rev" in back[0]["says"]
    assert len(out[0]["data"]) == 96, "48 bytes"
    assert sorted(each["time_s"] for each in frames) == [each["time_s"] for each in frames]
    assert statistics["buses"][0]["errors"] == 0 and 0 < statistics["buses"][0]["load"] < 1
    status = rig.ask("status")
    before = status["buses"][0]
    assert before["name"] == "can0" and before["sent"] > 100 and before["received"] > 100
    rig.wait_for(lambda: rig.ask("status")["buses"][0]["sent"] > before["sent"])
    assert "bus can0" in rig.lithe("status").stdout
    tell(
        f"{statistics['buses'][0]['frames_per_s']:.0f} frames/s seen, load {100 * statistics['buses'][0]['load']:.1f} %"
    )


def test_a_serial_adapter_of_a_running_robot_is_watched_through_its_spine(rig: RobotRig, tmp_path: Path) -> None:
    folder = tmp_path / "wires"
    rig.config = on_wires("arm", folder, {"can0": "fdcanusb"})
    with Simulated(rig.config, folder) as served:
        served.path()
        rig.run("--no-arm")
        for what in (rig.config, f"fdcanusb:{served.path().resolve()}"):
            frames = monitor(rig, what, "--count", 400, "--seconds", 20)[:-1]
            assert {each["device"] for each in frames} == {"shoulder_drive"}
            assert {each["direction"] for each in frames} == {"in", "out"}
        assert rig.ask("status")["mode"] == "disarmed"


def test_a_bus_that_nobody_owns_is_the_monitors(rig: RobotRig, tmp_path: Path) -> None:
    folder = tmp_path / "wires"
    file = on_wires("frankenstein", folder, FRANKENSTEIN)
    with Simulated(file, folder) as served:
        for bus in FRANKENSTEIN:
            served.path(bus)
        lines = monitor(rig, file, "--count", 20, "--seconds", 20, "--device", "hand_inputs")
        assert {each["device"] for each in lines[:-1]} == {"hand_inputs"}
        assert {each["says"].split(" ")[0] for each in lines[:-1]} <= {"analog", "digital", "imu"}
        people = rig.lithe("bus", "monitor", file, "--seconds", "0.3", "--bus", "can1")
        assert people.returncode == 0 and "frames/s" in people.stdout
        assert "only this monitor can use it" in people.stderr
        assert monitor(rig, file, "--bus", "can2", "--seconds", "0.2", code=1)[-1]["statistics"]["buses"][0]["in"] == 0


def test_it_ends_with_statistics_when_it_is_told_to(rig: RobotRig, tmp_path: Path) -> None:
    folder = tmp_path / "wires"
    with Simulated(on_wires("frankenstein", folder, FRANKENSTEIN), folder) as served:
        place = f"fdcanusb:{served.path('can1')}"
        watching = subprocess.Popen(
            [BIN / "lithe", "--json", "bus", "monitor", place], env=rig.env, stdout=subprocess.PIPE, text=True
        )
        try:
            assert watching.stdout is not None
            assert watching.stdout.readline().startswith("{")
            time.sleep(0.05)
            watching.send_signal(signal.SIGINT)
            rest = watching.stdout.read()
            assert "statistics" in json.loads(rest.splitlines()[-1])
            assert watching.wait(20) == 0
        finally:
            watching.kill()
            watching.communicate()


class Watching:
    """A monitor that runs on, and what it says beside its frames."""

    def __init__(self, rig: RobotRig, *words: object) -> None:
        """Starts it; its frames and its words go to files, so that it never waits for a reader."""
        self.frames, self.words = rig.dir / "frames", rig.dir / "words"
        with self.frames.open("w") as out, self.words.open("w") as err:
            command = [BIN / "lithe", "--json", "bus", "monitor", *map(str, words)]
            self.process = subprocess.Popen(command, env=rig.env, stdout=out, stderr=err)

    def seen(self) -> int:
        """Frames so far."""
        return len(self.frames.read_text().splitlines())

    def more(self, rig: RobotRig) -> None:
        """Waits until frames come."""
        before = self.seen()
        rig.wait_for(lambda: self.seen() > before + 10)

    def close(self) -> None:
        """Ends it."""
        self.process.kill()
        self.process.wait()


def test_a_spine_that_goes_is_told_of_and_its_next_one_is_watched(rig: RobotRig) -> None:
    first = rig.run()
    watching = Watching(rig, rig.config)
    try:
        watching.more(rig)
        rig.ask("stop")
        first.wait(30)
        rig.wait_for(lambda: "the Spine of robot 'arm' has gone" in watching.words.read_text())
        rig.run()
        watching.more(rig)
        assert "all is heard again" in watching.words.read_text()
    finally:
        watching.close()


def test_an_adapter_that_is_pulled_out_is_told_of_and_taken_back(rig: RobotRig, tmp_path: Path) -> None:
    folder = tmp_path / "wires"
    file = on_wires("frankenstein", folder, FRANKENSTEIN)
    with Simulated(file, folder) as served:
        watching = Watching(rig, f"fdcanusb:{served.path('can1')}")
        try:
            watching.more(rig)
            served.close()
            rig.wait_for(lambda: str(folder / "can1") in watching.words.read_text())
            with Simulated(file, folder) as again:
                again.path("can1")
                watching.more(rig)
        finally:
            watching.close()


def test_a_robot_whose_file_has_changed_is_not_passed_over_in_silence(rig: RobotRig, tmp_path: Path) -> None:
    rig.config = tmp_path / "arm.toml"
    text = calm_text({f'law = "{ROOT}/laws/pd.cpp"': ""})
    rig.config.write_text(text)
    rig.run("--no-arm")
    for changed in ("no longer a robot", text.replace('"can0"', '"canX"')):
        rig.config.write_text(changed)
        done = rig.lithe("bus", "monitor", "fdcanusb:/nowhere")
        assert "robot 'arm' runs, or may" in done.stderr, done.stderr


def test_bit_rates_that_no_bus_has_are_refused(rig: RobotRig) -> None:
    for words in (("--bitrate", "0"), ("--data-bitrate", "9000000"), ("--data-bitrate", "10")):
        refused = rig.ask("bus", "monitor", "socketcan:can0", *words, code=2)
        assert words[0] in refused["error"]["message"]


def test_what_cannot_be_watched_is_refused_with_what_to_do(rig: RobotRig) -> None:
    need("lithe")
    arm = ROBOTS / "arm.toml"
    simulated = rig.ask("bus", "monitor", arm, code=1)["error"]
    assert "'can0' is simulated" in simulated["message"] and simulated["next"].startswith("start the robot")
    assert "shoulder_drive" in rig.ask("bus", "monitor", arm, "--device", "x", code=2)["error"]["message"]
    assert rig.ask("bus", "monitor", ROOT / "absent.toml", code=2)["error"]["code"] == "bad_config"
    for what in ("socketcan:nocan9", "slcan:/dev/nocan9"):
        absent = rig.ask("bus", "monitor", what, code=1)["error"]
        assert re.search("nocan9: no such (interface|device)", absent["message"]), absent
        assert "who uses it" not in absent["next"], "nobody uses what does not exist"
        assert "ip -br link" in absent["next"] and "/dev/serial/by-id" in absent["next"]
    for what in ("socketcan:", "slcan:", "pi3hat:"):
        assert (
            f"{what} names no bus; one of: fdcanusb:PATH" in rig.ask("bus", "monitor", what, code=2)["error"]["message"]
        )
