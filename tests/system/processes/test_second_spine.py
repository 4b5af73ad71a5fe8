# SPDX-License-Identifier: Apache-2.0
"""One robot, one Spine."""

import subprocess

from system.robot_rig import BIN, RobotRig, alive


def test_a_second_spine_of_the_same_robot_is_refused_and_the_first_ticks_on(rig: RobotRig) -> None:
    """Exit 1, and one message that names the robot, the pid and what to do; the memory stays the first one's."""
    rig.run()
    before = rig.ask("status")
    files = {path: path.stat().st_ino for path in rig.segments()}
    command = [BIN / "lithe-spine-sim", rig.config]
    second = subprocess.run(command, env=rig.env, capture_output=True, text=True, timeout=30, check=False)
    assert second.returncode == 1
    assert second.stderr == (
        f"lithe-spine: robot 'arm' already has a Spine (pid {before['spine_pid']}); "
        "stop it first, or give this robot another name\n"
    )
    assert second.stdout == ""
    rig.wait_for(lambda: rig.ask("status")["tick"] > before["tick"])
    after = rig.ask("status")
    assert (after["spine_pid"], after["mode"]) == (before["spine_pid"], "active")
    assert {path: path.stat().st_ino for path in rig.segments()} == files


def test_another_name_is_another_robot(rig: RobotRig) -> None:
    """The control: the same binary, at the same time, on a robot of another name."""
    rig.run()
    other = rig.dir / "arm2.toml"
    other.write_text(rig.config.read_text().replace('name = "arm" ', 'name = "arm2"'))
    with subprocess.Popen([BIN / "lithe-spine-sim", other], env=rig.env, stdout=subprocess.PIPE, text=True) as second:
        assert second.stdout is not None
        assert '"event":"ready"' in second.stdout.readline().replace(" ", "")
        second.terminate()
        assert second.wait(30) == 0
    assert alive(rig.ask("status")["spine_pid"])
