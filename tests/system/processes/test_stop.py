# SPDX-License-Identifier: Apache-2.0
"""How a robot ends: what was confirmed, what was not, and what a supervisor never takes away from a living Spine."""

import json
import os
import signal
import socket
import subprocess
import threading
import time
from pathlib import Path

import pytest
from calm import calm_text
from system.robot_rig import BIN, ROOT, RobotRig, alive

LAYOUT_HASH_OFFSET_BYTES = 24  # docs/reference/wire.md: SegmentHeader


def test_drives_that_cannot_be_confirmed_off_exit_3(rig: RobotRig) -> None:
    """A Spine that hangs answers nothing: it is killed, and nobody says that all went well."""
    process = rig.run()
    spine = rig.ask("status")["spine_pid"]
    rig.freeze(spine)
    process.send_signal(signal.SIGTERM)
    assert process.wait(30) == 3
    assert "not confirmed that every drive" in rig.log()
    assert not alive(spine) and rig.segments() == []


def test_a_robot_on_its_estop_still_ends_in_order(rig: RobotRig) -> None:
    """The e-stop has the drives damp; that they do, and that the Spine's last word is off, is confirmation enough."""
    process = rig.run()
    assert rig.ask("estop")["mode"] == "estop"
    process.send_signal(signal.SIGTERM)
    assert process.wait(30) == 0, rig.log()


def test_a_swap_that_comes_while_the_robot_stops_is_refused_and_not_left_without_an_answer(rig: RobotRig) -> None:
    """The Spine hangs, so that the stop takes its time; the law is one that no cache knows."""
    process = rig.run()
    rig.freeze(rig.ask("status")["spine_pid"])
    source = (ROOT / "laws/pd.cpp").read_text() + f"// {os.urandom(8).hex()}\n"
    with socket.socket(socket.AF_UNIX) as link, link.makefile("rb") as answers:
        link.connect(str(rig.socket))
        link.settimeout(30)
        link.sendall(b'{"id": 1, "verb": "shutdown"}\n')
        assert json.loads(answers.readline())["result"]["stopping"]
        link.sendall(json.dumps({"id": 2, "verb": "swap", "args": {"source": source}}).encode() + b"\n")
        answer = answers.readline()
    assert answer, "it hung up"
    assert json.loads(answer)["error"]["code"] == "stopping"
    assert process.wait(30) == 3


def test_a_disarm_is_not_undone_by_an_arm_before_it(rig: RobotRig) -> None:
    """The arm waits for drives that are asked every fourth tick only."""
    changes = {"rate_divider = 1 ": "rate_divider = 4 ", "safe_kp_nm_rad = 1.0 ": "safe_kp_nm_rad = 0.2 "}
    rig.config.write_text(calm_text(changes))
    rig.run()
    rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
    verbs = ("disarm", "arm", "disarm")
    with socket.socket(socket.AF_UNIX) as link, link.makefile("rb") as answers:
        link.connect(str(rig.socket))
        link.settimeout(30)
        link.sendall(b"".join(json.dumps({"id": i, "verb": verb}).encode() + b"\n" for i, verb in enumerate(verbs)))
        for _ in verbs:
            answers.readline()
    time.sleep(0.3)  # an arm is sent again for 0.2 s
    assert rig.ask("status")["mode"] == "disarmed"


def test_an_error_of_the_supervisor_itself_stops_the_robot_and_exits_3(rig: RobotRig) -> None:
    """Its working directory is gone, so that the place of the records has no name: found out with a Spine running."""
    gone = rig.dir / "gone"
    gone.mkdir()
    env = {key: value for key, value in rig.env.items() if key != "LITHE_OUT_DIR"}
    command = f"rmdir {gone} && exec {BIN / 'lithe'} run {rig.config}"
    done = subprocess.run(
        ["/bin/sh", "-c", command], check=False, cwd=gone, env=env, capture_output=True, text=True, timeout=90
    )
    assert done.returncode == 3, done.stderr
    assert "went wrong" in done.stderr and "exit code 0" in done.stderr, "the Spine was stopped in order"
    assert rig.segments() == []


def test_an_answer_that_makes_no_sense_exits_3_with_a_message(rig: RobotRig) -> None:
    """A supervisor of another build, say: no verb of the command line ends in an abort."""
    rig.socket.parent.mkdir(parents=True, exist_ok=True)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(rig.socket))
        listener.listen()

        def answer() -> None:
            while True:
                try:
                    link, _ = listener.accept()
                except OSError:
                    return
                with link:
                    while asked := link.recv(4096):
                        told = {"id": json.loads(asked)["id"], "ok": True, "result": {"tick": "never"}}
                        link.sendall(json.dumps(told).encode() + b"\n")

        thread = threading.Thread(target=answer, daemon=True)
        thread.start()
        done = rig.lithe("arm")
        listener.shutdown(socket.SHUT_RDWR)
        thread.join(10)
    assert done.returncode == 3 and "went wrong" in done.stderr


@pytest.mark.parametrize("damage", ["layout", "memory"])
def test_a_living_spine_keeps_its_memory(rig: RobotRig, damage: str) -> None:
    """Its supervisor was killed and the next one cannot read it: refused with the pid, nothing removed or replaced."""
    process = rig.run()
    spine = rig.ask("status")["spine_pid"]
    process.kill()
    process.wait()
    segment = Path(f"/dev/shm/{rig.prefix}.arm.spine")
    with segment.open("r+b") as file:
        if damage == "layout":  # as of another build
            file.seek(LAYOUT_HASH_OFFSET_BYTES)
            file.write(b"otherwise")
        else:
            file.write(b"garbage!")
    before = {each: each.stat().st_ino for each in rig.segments()}
    assert len(before) == 4
    second = rig.run(wait=False)
    assert second.wait(60) == 1, rig.log()
    assert "already has a Spine" in rig.log() and "was left as it is" in rig.log()
    assert damage == "memory" or f"pid {spine}" in rig.log()
    assert alive(spine) and {each: each.stat().st_ino for each in rig.segments()} == before
    os.kill(spine, signal.SIGTERM)
    rig.wait_for(lambda: not alive(spine))
