# SPDX-License-Identifier: Apache-2.0
"""What a new `lithe run` finds of another one: a Spine, a socket, files; and what is not its own."""

import json
import os
import shutil
import signal
import socket
import subprocess

import pytest
from system.robot_rig import ROOT, RobotRig, alive

LAWS = ROOT / "laws"


def test_a_spine_of_another_robot_is_not_adopted(rig: RobotRig) -> None:
    """A file of the same name with other limits: refused with the keys; the same robot with a comment is taken over."""
    first = rig.run()
    before = rig.ask("status")
    first.kill()
    first.wait()
    rig.wait_for(lambda: not alive(before["lawd_pid"]))
    rig.socket.unlink()
    arm = rig.config
    text = arm.read_text()
    rig.config = rig.dir / "tighter.toml"
    tighter = [("= 3.0 ", "= 1.0 "), ("torque_max_nm = 0.6", "torque_max_nm = 0.3"), ("= 0.2 ", "= 0.25 ")]
    changed = text
    for was, now in tighter:
        assert was in changed
        changed = changed.replace(was, now)
    rig.config.write_text(changed)
    assert rig.run(wait=False).wait(60) == 1
    told = rig.log()
    assert f"Spine (pid {before['spine_pid']}), and it cannot be adopted" in told
    assert f"started with {arm}" in told and f"kill {before['spine_pid']}: its drives are switched off" in told
    assert "[[joint]] shoulder: position_max_rad = 1, and there 3\n" in told
    assert "[[joint]] shoulder: torque_max_nm = 0.3, and there 0.6\n" in told
    keys = {line.split(" = ")[0].split()[-1] for line in told.splitlines() if ", and there " in line}
    assert "torque_max_nm" in keys and keys.isdisjoint({"velocity_max_rad_s", "position_min_rad", "rate_hz"})
    assert alive(before["spine_pid"])
    (rig.dir / "run" / "arm.values").write_text("old = 1\n")
    assert rig.run(wait=False).wait(60) == 1
    assert "which values differ is not known" in rig.log()
    rig.config.write_text("# the same robot\n" + text)
    rig.run()
    rig.wait_for(lambda: rig.lithe("status").returncode == 0)
    after = rig.ask("status")
    assert after["adopted"] and after["spine_pid"] == before["spine_pid"] and after["mode"] == "active"
    rig.config.write_text(changed)  # the trial reads it only when it starts again
    assert rig.ask("swap", LAWS / "hold.cpp")["verdict"] == "committed"
    os.kill(after["trial_pid"], signal.SIGKILL)
    rig.wait_for(lambda: rig.ask("status")["trial_pid"] not in (0, after["trial_pid"]))
    refused = rig.ask("swap", LAWS / "pd.cpp", code=1)["error"]
    assert refused["code"] == "trial_unavailable" and "the robot file was changed" in refused["message"]


def test_a_socket_that_was_removed_is_made_again(rig: RobotRig) -> None:
    """Its file alone, then the whole folder; who is connected stays so. The pid file is there again, too."""
    process = rig.run()
    rig.wait_for(lambda: rig.lithe("status").returncode == 0)
    with socket.socket(socket.AF_UNIX) as link:
        link.connect(str(rig.socket))
        link.settimeout(60)
        for lost in (rig.socket.unlink, lambda: shutil.rmtree(rig.socket.parent)):
            lost()
            told = json.loads(rig.lithe("--json", "status").stdout)
            assert told.get("mode") or "socket that was removed is made again" in told["error"]["next"]
            rig.wait_for(lambda: rig.lithe("status").returncode == 0)
            assert rig.socket.with_suffix(".pid").read_text().strip() == str(process.pid)
            link.sendall(b'{"id": 1, "verb": "ping"}\n')
            assert json.loads(link.recv(4096))["ok"]
    process.send_signal(signal.SIGTERM)
    assert process.wait(30) == 0
    assert list(rig.socket.parent.glob("*.pid")) == [] and not rig.socket.exists()


def test_a_second_machine_with_the_same_run_folder_takes_nothing_over(rig: RobotRig) -> None:
    """A container: shared memory and pids of its own, the folder of the first."""
    first = rig.run()
    rig.wrapper = ["unshare", "-mpf", "sh", "-c", 'mount -t tmpfs tmpfs /dev/shm && exec "$@"', "sh"]
    if subprocess.run([*rig.wrapper, "true"], check=False, capture_output=True).returncode != 0:
        pytest.skip("no privilege to make a container's view")
    assert rig.run(wait=False).wait(60) == 1
    assert f"another supervisor of a robot 'arm', perhaps in another container, holds {rig.socket.parent}" in rig.log()
    assert f"(pid {first.pid} there)" in rig.log()
    assert rig.ask("status")["supervisor_pid"] == first.pid and rig.ask("status")["mode"] == "active"
    assert rig.socket.with_suffix(".pid").read_text().strip() == str(first.pid)
    assert rig.socket.with_suffix(".values").exists()


def test_a_pipe_in_the_place_of_the_records_is_named_and_holds_nobody(rig: RobotRig) -> None:
    """Nobody reads or writes its other end."""
    swaps = rig.dir / "out" / "arm" / "swaps"
    swaps.mkdir(parents=True)
    for name in ("chain.jsonl", "0001.json"):
        os.mkfifo(swaps / name)
    rig.run()
    assert rig.ask("swap", LAWS / "hold.cpp")["verdict"] == "committed"
    assert "chain.jsonl: is a device, a pipe or a socket, not a file" in rig.ask("status")["certificates_error"]


def test_a_robot_file_that_was_copied_alone_finds_its_law(rig: RobotRig) -> None:
    """Its law is looked for beside it, then among those that come with LITHE."""
    alone = rig.dir / "below" / "arm.toml"
    alone.parent.mkdir()
    text = rig.config.read_text()
    assert f'"{LAWS}/pd.cpp"' in text
    alone.write_text(text.replace(f'"{LAWS}/pd.cpp"', '"../laws/pd.cpp"'))
    rig.config = alone
    rig.run()
    assert rig.ask("status")["law"] == "pd"
    assert f"there is no {rig.dir}/laws/pd.cpp: {LAWS / 'pd.cpp'} is taken" in rig.log(), rig.log()
