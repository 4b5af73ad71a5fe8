# SPDX-License-Identifier: Apache-2.0
"""What docs/swap.md lists as not contained ends as it says there: with open gates, which nobody needs for a robot."""

import platform
from pathlib import Path

import pytest
from calm import calm_robot, connected
from system.laws.test_hostile_admission import CORPUS, header
from system.robot_rig import ROOT

LAWS = [law for law in CORPUS if header(law, "without-gates") == "not_contained"]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.stem)
def test_a_law_without_gates_that_moves_the_threads_own_memory_ends_the_spine(law: Path) -> None:
    """`lithe run` ends with it, says how, and that the drives stop the robot. The page has a row for it."""
    if "fsbase" in law.read_text() and "fsgsbase" not in Path("/proc/cpuinfo").read_text():
        pytest.skip(f"{platform.machine()} without that instruction")
    with calm_robot("--ungated") as rig, connected() as robot:
        robot.swap(law.read_text(), name=law.name)
        assert rig.started[-1].wait(timeout=60) != 0
        said = rig.log()
        assert "killed by signal 11" in said, said
        assert "the drives' own watchdogs stop the robot" in said, said
    listed = (ROOT / "docs/swap.md").read_text().split("## What is not contained")[1]
    assert "`killed by signal 11`" in listed


def test_there_is_one_for_each_way_to_write_it() -> None:
    """Else the test above would test nothing."""
    assert {law.stem for law in LAWS} == {"moves_the_thread_pointer", "writes_the_thread_pointer"}
