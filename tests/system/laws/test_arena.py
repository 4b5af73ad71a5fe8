# SPDX-License-Identifier: Apache-2.0
"""Laws in the code arena: whole swaps, from the command line to the Spine's memory map."""

import os
import signal
import sys
from pathlib import Path
from typing import Any

import pytest
from calm import calm_text
from system.robot_rig import ROOT, RobotRig, alive

LAWS = [ROOT / f"laws/{name}.cpp" for name in ("hold", "pd", "gravity_pd")]
SLOTS = 16


def need_arena(rig: RobotRig) -> dict[str, Any]:
    """The status of a robot whose laws are placed, or the test is skipped with the reason."""
    status: dict[str, Any] = rig.ask("status")
    if status["loader"] != "arena":
        pytest.skip(f"no privilege to map code from memory here: {status['lost']}")
    return status


def swap(rig: RobotRig, number: int) -> dict[str, Any]:
    """One swap, and what is resident afterwards: the active law has a slot that is its own.

    Without a probation: what a busy machine does to the tracking is no matter of slots.
    """
    law = LAWS[number % len(LAWS)]
    done = rig.ask("swap", law, "--no-probation")
    assert done["verdict"] == "committed" and done["law"] == law.stem
    resident = rig.ask("law", "list")["resident"]
    slots = [each["slot"] for each in resident if each["slot"] is not None]
    assert len(set(slots)) == len(slots), resident
    active: list[dict[str, Any]] = [each for each in resident if each["active"]]
    assert [each["law"] for each in active] == [law.stem], rig.ask("events")["events"][-20:]
    return active[0]


def code_maps(pid: int) -> list[str]:
    """The lines of a process's memory map that laws' code could lie in."""
    lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
    return [line for line in lines if "lithe-arena" in line or "/laws/" in line]


def resident_kib(pid: int) -> int:
    """Memory of a process that is really there."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE") // 1024


def test_swaps_reuse_the_slots_and_leave_the_spines_memory_as_it_was(rig: RobotRig) -> None:
    """40 swaps through 16 slots: the same map, read+execute only, and no more memory than before."""
    rig.run()
    pid = need_arena(rig)["spine_pid"]
    slots = [swap(rig, number)["slot"] for number in range(8)]
    maps_before = Path(f"/proc/{pid}/maps").read_text()
    before_kib = resident_kib(pid)
    slots += [swap(rig, number)["slot"] for number in range(8, 40)]
    assert set(slots) == set(range(1, SLOTS + 1)), "every slot had its turn, most of them more than once"
    assert Path(f"/proc/{pid}/maps").read_text() == maps_before, "a swap maps nothing"
    assert resident_kib(pid) - before_kib <= 64
    (line,) = code_maps(pid)
    assert line.split()[1] == "r-xs", "a law must not be able to write code"
    assert rig.ask("rollback")["law"] == LAWS[38 % len(LAWS)].stem
    assert rig.ask("status")["mode"] == "active"


def test_a_new_supervisor_goes_on_with_the_arena_it_finds(rig: RobotRig) -> None:
    """The Spine outlives its supervisor; the next one writes into the same slots, but not into those in use."""
    first = rig.run()
    pid = need_arena(rig)["spine_pid"]
    for number in range(6):
        swap(rig, number)
    os.kill(first.pid, signal.SIGKILL)
    first.wait()
    assert alive(pid)
    rig.socket.unlink(missing_ok=True)
    rig.run()
    assert need_arena(rig)["spine_pid"] == pid
    for number in range(20):
        swap(rig, number)
    assert len(code_maps(pid)) == 1


def test_a_new_compile_service_goes_on_with_the_same_arena(rig: RobotRig) -> None:
    """lawd dies, another one is started, and places into the slots that are free."""
    rig.run()
    status = need_arena(rig)
    swap(rig, 0)
    os.kill(status["lawd_pid"], signal.SIGKILL)
    rig.wait_for(lambda: rig.ask("status")["lawd_pid"] not in (0, status["lawd_pid"]))
    assert swap(rig, 1)["slot"] is not None
    assert swap(rig, 2)["slot"] is not None


def test_dlopen_is_a_word_in_the_robot_file(rig: RobotRig) -> None:
    """The portable back end, chosen."""
    rig.config.write_text(calm_text().replace('loader = "arena" ', 'loader = "dlopen"'))
    rig.run()
    status = rig.ask("status")
    assert status["loader"] == "dlopen" and "dlopen" not in status["lost"]
    assert [swap(rig, number)["slot"] is None for number in range(3)] == [True] * 3
    assert all("memfd" not in line for line in code_maps(status["spine_pid"]))


def test_without_memfd_laws_are_loaded_with_dlopen_and_the_notes_say_so(rig: RobotRig) -> None:
    """A system that refuses the arena costs interrupts, not the robot."""
    rig.wrapper = [sys.executable, str(Path(__file__).with_name("without_call.py")), "memfd"]
    rig.run(wait=False)
    rig.wait_for(lambda: rig.socket.exists() or rig.started[0].poll() is not None, 90)
    if "no seccomp filters" in rig.log():
        pytest.skip(f"no privilege to install a filter: {rig.log()}")
    status = rig.ask("status")
    assert status["loader"] == "dlopen"
    assert "laws are loaded with dlopen" in status["lost"]
    assert "cannot make the code arena" in rig.log()
    assert [rig.ask("swap", law)["law"] for law in LAWS] == ["hold", "pd", "gravity_pd"]


def test_a_gate_that_the_kernel_lacks_is_told_in_status(rig: RobotRig) -> None:
    """Without syscall user dispatch a law is kept from the kernel by less: the user must see that, not only a log."""
    rig.wrapper = [sys.executable, str(Path(__file__).with_name("without_call.py")), "dispatch"]
    rig.run(wait=False)
    rig.wait_for(lambda: rig.socket.exists() or rig.started[0].poll() is not None, 90)
    if "no seccomp filters" in rig.log():
        pytest.skip(f"no privilege to install a filter: {rig.log()}")
    status = rig.ask("status")
    assert "a law can make system calls" in status["lost"], status["lost"]
    assert rig.ask("swap", LAWS[0])["law"] == "hold"
