# SPDX-License-Identifier: Apache-2.0
"""A real kernel, booted with isolcpus=1-3: the Spine has an isolated core and says so, also in a partition of cgroup
v2. Skipped, with the reason, where no machine can be booted. What faked files say: spine/core/host/cores_test.cpp,
spine/core/host/interrupts_test.cpp, spine/robot/cores/cpu_plan_test.cpp."""

import json
import re
from pathlib import Path
from typing import Any

import calm
import pytest
from system.host.booted import booted
from system.robot_rig import ROOT
from vm import machine

SCRIPT = Path(__file__).with_name("isolated_cores.sh")
LAW = f'law = "{ROOT}/laws/pd.cpp"'  # there is no compiler
# It is emulated.
SLOWLY = {"rate_hz = 1000 ": "rate_hz = 100 ", "safe_kp_nm_rad = 1.0 ": "safe_kp_nm_rad = 0.5 ", LAW: ""}


def robot(core: str = '"auto"') -> bytes:
    """The arm in simulation, with a core for the Spine."""
    text = calm.changed(calm.calm_text(), SLOWLY, "the calm arm")
    return calm.changed(text, {'cpu_spine = "auto" ': f"cpu_spine = {core} "}, "robots/arm.toml").encode()


@pytest.fixture(scope="module")
def steps() -> dict[str, machine.Step]:
    """What the script did, each step ended as it must."""
    files = {"robot.toml": robot(), "named.toml": robot("2"), "absent.toml": robot("999")}
    return booted(SCRIPT, files, {"absent": 2}, options="isolcpus=1-3")


def cpus(step: machine.Step) -> dict[str, Any]:
    """Which cores `lithe status` tells."""
    told: dict[str, Any] = json.loads(step.text)["cpus"]
    return told


def pinned(step: machine.Step) -> set[str]:
    """The affinities of the Spine's threads."""
    return set(re.findall(r"Cpus_allowed_list:\s*(\S+)", step.text))


def test_the_kernel_is_one_that_gives_only_core_0_to_who_does_not_ask(steps: dict[str, machine.Step]) -> None:
    assert steps["isolated"].text.strip() == "1-3"
    assert steps["affinity"].text.split() == ["Cpus_allowed_list:", "0"]


def test_each_role_has_a_core_and_the_spines_is_isolated(steps: dict[str, machine.Step]) -> None:
    told = cpus(steps["status"])
    assert [told[role] for role in ("housekeeping", "spine", "brain", "transport")] == [0, 1, 2, 3]
    assert told["transport_inline"] is False
    core = told["spine_core"]
    assert (core["isolation"], core["isolated_cores"]) == ("boot", "1-3"), core
    assert (core["words"], core["why"]) == ("isolated at boot (isolcpus)", "isolated cores come first")
    assert {"0", "1", "3"} <= pinned(steps["threads"]), "the kernel says the same of the threads"
    assert "the Spine's core: 1, isolated at boot (isolcpus) (isolated cores come first)" in steps["words"].text
    told_of_devices = core["interrupts"]
    assert told_of_devices["count"] is not None, told_of_devices
    assert len(told_of_devices["named"]) == min(told_of_devices["count"], 8)
    assert f"    interrupts: {told_of_devices['words']}" in steps["words"].text
    assert "shares core" not in steps["words"].text and "shares core" not in steps["run-log"].text


def test_an_isolated_core_can_be_named(steps: dict[str, machine.Step]) -> None:
    told = cpus(steps["named"])
    assert (told["spine"], told["spine_core"]["isolation"]) == (2, "boot")
    assert told["spine_core"]["why"] == "the robot file names it"
    assert "2" in pinned(steps["named-threads"])


def test_a_real_partition_of_cgroup_v2_is_told(steps: dict[str, machine.Step]) -> None:
    assert steps["partition"].text.strip() == "isolated"
    told = cpus(steps["inside"])
    assert told["spine"] in (2, 3) and told["spine_core"]["isolation"] == "cpuset", told
    assert told["spine_core"]["words"] == "isolated by its cpuset (a partition of cgroup v2)"
    assert "isolated by its cpuset (a partition of cgroup v2)" in steps["inside-words"].text


def test_a_core_that_is_not_there_is_refused_with_those_that_are(steps: dict[str, machine.Step]) -> None:
    assert steps["absent"].code == 2
    assert "spine.cpu_spine = 999, but this machine has cores 0-3; name one of 0-3" in steps["absent"].text


def test_the_benches_take_the_same_core(steps: dict[str, machine.Step]) -> None:
    told = json.loads(steps["benches"].text)
    assert (told["machine_spine_core"], told["machine_partner_core"], told["machine_usable_cores"]) == (1, 3, 4)
    assert told["machine_spine_core_isolation"] == "isolated at boot (isolcpus)"
