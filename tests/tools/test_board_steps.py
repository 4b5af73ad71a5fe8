# SPDX-License-Identifier: Apache-2.0
"""The steps that a board takes: which, with what, and on which cores of this computer."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from vm import board_systems, machine, on_board
from vm.verdict import Verdict


def test_a_step_that_a_board_has_not_is_refused() -> None:
    assert board_systems.chosen(("swaps", "demo"), "demo") == ("demo",)
    with pytest.raises(ValueError, match="--only swap: no such step; there are swaps, demo"):
        board_systems.chosen(("swaps", "demo"), "swap")


def seen(**said: str) -> tuple[board_systems.Seen, list[str]]:
    """Steps that ended with 0 and said this, and what is wrong with them."""
    verdict = Verdict("r")
    text = "".join(f"vm: begin {name}\n{each}\nvm: end {name} 0\n" for name, each in said.items())
    return board_systems.Seen(verdict, text, tuple(said)), verdict.wrong


@pytest.mark.parametrize("said", ["", "{not json", "[ 3.1] oops {brace\n{}", json.dumps({"error": "it raised"})])
def test_a_step_that_ended_well_and_told_nothing_that_can_be_judged_is_wrong(said: str) -> None:
    steps, wrong = seen(robot=said, stop='{"code": 0}')
    board_systems.judge_common(steps)
    assert wrong == ["robot: it ended, and its document cannot be read"]


def test_a_step_without_a_result_has_no_figures() -> None:
    steps, wrong = seen(robot='{"mode": "active", "cpus": {"spine": 3}}')
    doctor, robot, *others = board_systems.rt_lines(steps, "")
    assert (doctor, robot, wrong) == ("doctor: no result", "lithe run: active, Spine on core 3", [])
    assert others == ["plans from Python: no result", "swaps: no result"]
    arm = board_systems.arm_lines(seen(demo='{"verdict": "holds", "swaps": [1, 2]}')[0])
    assert arm.pop() == "demo at 250 Hz: holds, 2 swaps"
    assert len(arm) == 7 and all(line.endswith(": no result") for line in arm)


def test_a_step_with_a_result_tells_it() -> None:
    words = '{"kernel": {"words": "6.1"}, "label": "D-v"}', '{"swaps": {}, "certificates": 1}'
    doctor, _, _, swaps = board_systems.rt_lines(seen(doctor=words[0], swaps=words[1])[0], "A-v")
    assert doctor.endswith(
        "tier D-v, booted with the line of `lithe tune` A-v; all 39 items as a shell script reads them"
    )
    assert swaps.endswith("1 certificates, chain holds")
    laws = '{"laws": {"full_torque": {"kinds": ["overran"], "wanted": "clamp", "as_said": true}}}'
    contained = board_systems.arm_lines(seen(contained=laws)[0])[6]
    assert contained.endswith("1 ran (faults contained: overran; limited by the guard: full_torque)")


def test_each_step_has_all_cores_also_after_a_brain(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def brain() -> dict[str, Any]:
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
        return {}

    monkeypatch.setattr(on_board, "STEPS", {"brain": brain, "next": lambda: {"cores": len(os.sched_getaffinity(0))}})
    monkeypatch.setattr(sys, "argv", ["on_board.py", "brain", "next"])
    cores = os.sched_getaffinity(0)
    on_board.main()
    os.sched_setaffinity(0, cores)
    assert f'"cores": {len(cores)}' in capsys.readouterr().out


EMULATOR = """
import os, sys, threading
def serve(core):
    with open(f"/proc/self/task/{threading.get_native_id()}/comm", "w") as comm: comm.write(f"CPU {core}/TCG")
    named.wait(); sys.stdin.read()
named = threading.Barrier(5)
for core in range(4): threading.Thread(target=serve, args=[core]).start()
named.wait(); print(flush=True)
"""


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="this computer has one core")
def test_the_core_of_the_spine_is_emulated_apart_from_the_others() -> None:
    cores = sorted(os.sched_getaffinity(0))
    with subprocess.Popen([sys.executable, "-c", EMULATOR], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as emulator:
        assert emulator.stdout is not None and emulator.stdout.readline() == b"\n"
        machine.keep_apart(emulator.pid, 4, 1)
        threads = Path(f"/proc/{emulator.pid}/task").iterdir()
        on = {(path / "comm").read_text().strip(): sorted(os.sched_getaffinity(int(path.name))) for path in threads}
        emulator.communicate()
    assert on.pop("CPU 1/TCG") == cores[-1:]
    assert [on.pop(f"CPU {core}/TCG") for core in (0, 2, 3)] == [cores[:-1]] * 3
    assert list(on.values()) == [cores], "the thread of the timers goes where it can run"
