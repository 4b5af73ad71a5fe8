# SPDX-License-Identifier: Apache-2.0
"""Files that are no files, folders that go, limits that are reached: an error with words, and the robot goes on."""

import fcntl
import os
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import lithe
import pytest
from calm import calm_robot, connected
from lithe.demo import __main__ as demo
from lithe.files import read_regular
from system.robot_rig import ROOT, RobotRig
from system.swapping import certificates, folder

HOLD, PD = ROOT / "laws/hold.cpp", ROOT / "laws/pd.cpp"


def no_files(place: Path) -> dict[str, Path]:
    """What can stand where a file should, and what is said of it."""
    (place / "large.cpp").write_bytes(b"/" * (1 << 21))
    os.mkfifo(place / "pipe")
    return {
        "is a directory": place,
        "is a device": Path("/dev/zero"),
        "a pipe": place / "pipe",
        "is larger than": place / "large.cpp",
        "No such file": place / "absent.cpp",
    }


def test_a_first_law_that_is_no_file_is_refused_with_the_reason(rig: RobotRig) -> None:
    """It ended in "the supervisor itself went wrong", or read without end."""
    for said, path in no_files(rig.dir).items():
        process = rig.run("--law", str(path), wait=False)
        assert process.wait(60) == 2, (path, rig.log())
        assert said in rig.log() and "--law FILE" in rig.log() and "went wrong" not in rig.log()
    assert rig.segments() == []


def test_no_command_reads_without_end(rig: RobotRig) -> None:
    """Laws, robot files, certificates: whoever names them."""
    for said, path in no_files(rig.dir).items():
        for words in (("swap", path), ("law", "check", path), ("run", path), ("bus", "plan", path)):
            done = rig.lithe(*words)
            assert done.returncode == 2 and said in done.stderr, (words, done)
    swaps = rig.dir / "swaps"
    swaps.mkdir()
    os.mkfifo(swaps / "0001.json")
    (swaps / "chain.jsonl").write_text("")
    assert rig.lithe("law", "show", "--folder", swaps).returncode == 1
    assert rig.lithe("law", "verify", "--folder", swaps).returncode == 1


def test_the_brain_reads_no_device_either(tmp_path: Path) -> None:
    """`robot.swap(Path(...))`, the token file, the robot file of the heartbeat."""
    for said, path in no_files(tmp_path).items():
        with pytest.raises(OSError, match=said):
            read_regular(path)
    assert read_regular(HOLD) == HOLD.read_text()
    with pytest.raises(lithe.LitheError, match="cannot read the token file"):
        lithe.Remote("127.0.0.1", 1, Path("/dev/zero"))
    with calm_robot(), connected() as robot, pytest.raises(lithe.LitheError, match="a device"):
        robot.swap(Path("/dev/zero"))


@pytest.mark.parametrize("blocks", [0, 1, 64, 4096])
def test_a_start_under_a_limit_of_file_sizes_says_what_cannot_be_written(rig: RobotRig, blocks: int) -> None:
    """It died of SIGXFSZ without a word."""
    rig.wrapper = ["bash", "-c", f'set -o pipefail; (ulimit -f {blocks}; exec "$@" 2>&1) | cat', "bash"]
    process = rig.run(wait=False)
    code = process.wait(60)
    assert code in (1, 3), (code, rig.log())
    assert "large" in rig.log() or "limit" in rig.log(), rig.log()
    assert rig.segments() == []


def test_a_limit_reached_while_the_robot_runs_costs_certificates_only_for_so_long(arm: RobotRig) -> None:
    """The swap is done, `status` says what is missing, and it comes when there is room."""
    supervisor = arm.ask("status")["supervisor_pid"]
    resource.prlimit(supervisor, resource.RLIMIT_FSIZE, (200, resource.RLIM_INFINITY))
    done = arm.ask("swap", HOLD)
    assert done["verdict"] == "committed" and "cannot write" in done["record_lost"]
    assert "limit" in arm.ask("status")["certificates_error"]
    assert "CERTIFICATES" in arm.lithe("status").stdout
    resource.prlimit(supervisor, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    arm.wait_for(lambda: any(each["request_id"] == done["request_id"] for each in certificates(arm)))
    arm.wait_for(lambda: arm.ask("status")["certificates_error"] is None)


def test_certificates_come_back_when_their_folder_was_removed(arm: RobotRig) -> None:
    """With a chain that holds, and `status` says that something is gone."""
    arm.ask("swap", HOLD)
    assert arm.ask("status")["certificates_error"] is None
    shutil.rmtree(arm.dir / "out")
    done = arm.ask("swap", PD)
    assert "record_lost" not in done
    assert any(each["request_id"] == done["request_id"] for each in certificates(arm))
    assert "was removed" in arm.ask("status")["certificates_error"]
    assert "was removed" in arm.lithe("status").stdout
    arm.ask("swap", HOLD)
    assert arm.lithe("law", "verify", "--folder", folder(arm)).returncode == 0


def test_a_second_demo_in_the_same_folder_is_refused_and_touches_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It would write into the first one's log."""
    with demo.alone_in(tmp_path):
        (tmp_path / "log.txt").write_text("the first one's")
        monkeypatch.setattr(sys, "argv", ["demo", "--out", str(tmp_path)])
        before = signal.getsignal(signal.SIGTERM)
        try:
            assert demo.main() == 1
        finally:
            signal.signal(signal.SIGTERM, before)
    assert "another demo writes to" in capsys.readouterr().err
    assert (tmp_path / "log.txt").read_text() == "the first one's"
    with demo.alone_in(tmp_path):
        pass


def test_make_demo_beside_a_demo_builds_nothing() -> None:
    """A build would change the first one's programs under its feet."""
    out = ROOT / "out/demo"
    out.mkdir(parents=True, exist_ok=True)
    with (out / demo.LOCK).open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        done = subprocess.run(["make", "demo"], check=False, cwd=ROOT, capture_output=True, text=True, timeout=60)
        assert done.returncode != 0 and "another demo runs in this checkout" in done.stderr, done
        assert "ninja" not in done.stdout and done.stdout.strip() == ""
