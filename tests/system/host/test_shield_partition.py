# SPDX-License-Identifier: Apache-2.0
"""A real kernel: a shield that is an isolated partition of cgroup v2, around a command, around a robot, and left behind
by a killed one. Skipped, with the reason, where no machine can be booted. On faked files: host/tune/shield/."""

import json
from pathlib import Path
from typing import Any

import pytest
from system.host.booted import booted
from system.host.test_isolated_cores import pinned, robot
from vm import machine

SCRIPT = Path(__file__).with_name("shield_partition.sh")
PINNED = ["0", "1", "0-3"]  # two tasks that chose a core, and one that chose nothing


@pytest.fixture(scope="module")
def steps() -> dict[str, machine.Step]:
    """What the script did, each step ended as it must."""
    return booted(SCRIPT, {"robot.toml": robot()}, {"taken": 1})


def lines(step: machine.Step) -> list[str]:
    """Without what the shield itself says."""
    return [line for line in step.text.split("\n") if line and not line.startswith("shield: ")]


def items(step: machine.Step) -> dict[str, Any]:
    """State of each item of the doctor."""
    return {item["id"]: item["state"] for item in json.loads(step.text)["items"]}


def test_a_command_has_the_core_and_no_other(steps: dict[str, machine.Step]) -> None:
    group, mask, state, kept, *others = lines(steps["command"])[-7:]
    assert group == "0::/lithe.spine", steps["command"].text
    assert mask.split() == ["Cpus_allowed_list:", "1"]
    assert "core 1, cpuset2" in steps["command"].text
    assert state == "isolated"
    assert kept == "isolated", "what systemd would write did not end it"
    assert others[0] == "0" and others[2] == "0,2-3", "a task's own choice stays, and nobody else has the core"


def test_every_task_has_its_cores_back_and_no_group_is_left(steps: dict[str, machine.Step]) -> None:
    assert steps["masks"].text.split() == PINNED
    for name in ("command", "run", "revert"):
        assert steps[f"{name}-gone"].text.strip() == "", "the root's controllers as before"
        assert steps[f"{name}-masks"].text.split() == PINNED, name


def test_a_spines_threads_join_and_the_others_stay_outside(steps: dict[str, machine.Step]) -> None:
    told = json.loads(steps["status"].text)
    assert told["shield"]["mechanism"] == "cpuset2", told["shield"]
    assert [told["cpus"][role] for role in ("housekeeping", "spine", "brain", "transport")] == [0, 1, 2, 3]
    assert told["cpus"]["spine_core"]["isolation"] == "cpuset"
    assert {"0", "1", "3"} <= pinned(steps["threads"])
    assert steps["state"].text.strip() == "isolated"


def test_nobody_else_gets_the_core_and_the_doctor_says_so(steps: dict[str, machine.Step]) -> None:
    assert steps["taken"].code == 1, "taskset -c 1 was refused by the kernel"
    told = items(steps["doctor"])
    for name in ("domain_isolation", "isolated_partition", "user_tasks", "kernel_threads", "spine_pinned"):
        assert told[name] == "ok", (name, told)


def test_what_a_killed_supervisor_left_is_reverted(steps: dict[str, machine.Step]) -> None:
    assert steps["left"].text.strip() == "isolated"


def test_a_command_ends_with_its_killed_shield(steps: dict[str, machine.Step]) -> None:
    assert steps["orphan-starts"].code == steps["orphan-ends"].code == 0
