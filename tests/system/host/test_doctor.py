# SPDX-License-Identifier: Apache-2.0
"""`lithe doctor` on the machine of the tests, beside what a shell script reads: doctor_expected.sh, which shares no
line with it. Also in a user namespace, where nothing may be set and root is nobody. Faked machines, with each trap:
host/doctor/."""

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from system.robot_rig import BIN, ROOT, RobotRig, need

SCRIPT = Path(__file__).with_name("doctor_expected.sh")
pytestmark = pytest.mark.alone  # the script is for a machine without a robot, and a measurement uses up a core

NAMESPACE = ("unshare", "-r")
CONTAINER = ("unshare", "-rpf", "--mount-proc")  # it sees its own tasks only
ITEMS = 39
TIERS = "ABCD"
# What a task that starts or ends between the two readings may change: these agree at one of three attempts, all others
# at the first.
OF_TASKS = {"v1_shield", "user_tasks", "kernel_threads", "irqbalance", "rcu_callbacks"}
ATTEMPTS = 3


def read(way: tuple[str, ...], *words: str) -> dict[str, Any]:
    """The answer of the doctor; its exit code must fit the tier."""
    command = [*way, BIN / "lithe", "--json", "doctor", *words]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    told: dict[str, Any] = json.loads(done.stdout)
    assert done.returncode == (0 if told["tier"] in "AB" else 1), told["tier"]
    return told


def states(told: dict[str, Any]) -> dict[str, str]:
    """State of each item, by its name."""
    return {item["id"]: item["state"] for item in told["items"]}


def expected(way: tuple[str, ...], cpu: int) -> dict[str, str]:
    """The same, as the shell script says."""
    done = subprocess.run([*way, "bash", SCRIPT, str(cpu)], check=True, capture_output=True, text=True, timeout=120)
    return dict(line.split() for line in done.stdout.splitlines())


@pytest.fixture(autouse=True)
def _no_robot() -> None:
    """The doctor judges a robot that runs, too; the script does not."""
    need("lithe")
    for name in Path("/proc").glob("[0-9]*/comm"):
        if name.read_text().startswith("lithe-spine"):
            pytest.skip(f"a robot runs on this machine: {name}")


def compare(way: tuple[str, ...], tell: Callable[[str], None]) -> dict[str, Any]:
    """Both readings of the same core, item by item."""
    for _ in range(ATTEMPTS):
        told = read(way)
        reported, wanted = states(told), expected(way, told["cpu"])
        assert len(reported) == len(told["items"]) == ITEMS and reported.keys() == wanted.keys()
        different = {name: (wanted[name], reported[name]) for name in wanted if wanted[name] != reported[name]}
        if not different or different.keys() - OF_TASKS:
            break
    assert different == {}, f"(expected, reported) on core {told['cpu']}"
    tell(f"tier {told['label']} on core {told['cpu']}; {len(wanted)} items as the script says")
    tell("; ".join(f"{name} expected {wanted[name]} reported {reported[name]}" for name in wanted))
    return told


def test_each_item_is_as_a_shell_script_reads_it(tell: Callable[[str], None]) -> None:
    told = compare((), tell)
    assert told["measured"] is None
    for item in told["items"]:
        assert item["words"] and item["why"] and item["fix"], item
        if item["state"] in ("ok", "warn", "fail"):
            assert item["evidence"], f"{item['id']}: a verdict without a path"
    gates = {"fail", "warn", "unknown"}
    if told["tier"] != "A":
        assert told["missing"] and all(each["tier"] == TIERS[TIERS.index(told["tier"]) - 1] for each in told["missing"])
        reported = states(told)
        assert all(reported.get(each["id"], "fail") in gates for each in told["missing"]), told["missing"]


def test_a_namespace_without_rights_makes_nothing_better(tell: Callable[[str], None]) -> None:
    tried = subprocess.run([*NAMESPACE, "true"], check=False, capture_output=True, text=True)
    if tried.returncode != 0:
        pytest.skip(f"no user namespace here: {tried.stderr.strip()}")
    inside, outside = compare(NAMESPACE, tell), read(())
    assert inside["tier"] >= outside["tier"], "A is the best tier"
    good = {name for name, state in states(outside).items() if state == "ok"}
    better = {name for name, state in states(inside).items() if state == "ok"} - good
    assert better == set(), f"better without rights: {better}"


def test_a_measurement_fills_in_what_no_file_tells() -> None:
    told = read((), "--measure", "0.5")
    seen = told["measured"]
    assert seen["cpu"] == told["cpu"] and seen["seconds"] >= 0.5
    assert 0 <= seen["gap_share"] < 1 and seen["gaps_per_s"] >= 0
    assert [each["rate_hz"] for each in seen["rates"]] == [250, 500, 1000, 2000, 4000, 8000]
    assert all(each["holds"] == (each["lost_share"] <= 1e-3) for each in seen["rates"])
    assert states(told)["bound_kernel_threads"] in ("ok", "warn")
    no_phase = seen["gaps_per_s"] > 0 and not any(seen["phase_share"])  # gaps above 500 us alone tell none
    assert states(told)["release_phase"] in (("unknown",) if no_phase else ("ok", "warn"))


def test_a_measurement_in_a_container_does_not_stand_for_what_is_not_seen() -> None:
    tried = subprocess.run([*CONTAINER, "true"], check=False, capture_output=True, text=True)
    if tried.returncode != 0:
        pytest.skip(f"no user namespace here: {tried.stderr.strip()}")
    command = [*CONTAINER, BIN / "lithe", "--json", "doctor", "--measure", "0.5"]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1 and "cannot be seen" in done.stderr, done.stdout + done.stderr
    told = json.loads(done.stdout)
    assert told["measured"]["seconds"] >= 0.5 and told["measured"]["switches_per_s"] is not None
    reported = states(told)
    assert reported["bound_kernel_threads"] in ("ok", "warn"), "the kernel counts the switches of each thread"
    unseen = {name: reported[name] for name in ("user_tasks", "kernel_threads", "spine_pinned")}
    assert set(unseen.values()) == {"unknown"}, unseen
    assert told["tier"] == "D" and "user_tasks" in [each["id"] for each in told["missing"]]


def test_beside_a_spine_it_reads_and_does_not_measure(tmp_path: Path) -> None:
    """A program with the name of a Spine, pinned to the core, without locked memory."""
    cpu = str(read(())["cpu"])
    program = tmp_path / "lithe-spine"
    shutil.copy(shutil.which("sleep") or "/bin/sleep", program)
    with subprocess.Popen(["taskset", "-c", cpu, program, "100"]) as spine:
        try:
            RobotRig.wait_for(lambda: Path(f"/proc/{spine.pid}/comm").read_text().strip() == program.name)
            told = states(read((), "--cpu", cpu))
            assert (told["spine_pinned"], told["memory_lock"]) == ("ok", "fail")
            command = [BIN / "lithe", "doctor", "--cpu", cpu, "--measure", "1"]
            refused = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
            assert refused.returncode == 2, refused.stdout
            assert f"pid {spine.pid}" in refused.stderr, refused.stderr
        finally:
            spine.kill()


def test_two_spines_on_one_core_are_told_with_both_pids(tmp_path: Path) -> None:
    """Two programs with the name of a Spine."""
    cpu = str(read(())["cpu"])
    program = tmp_path / "lithe-spine"
    shutil.copy(shutil.which("sleep") or "/bin/sleep", program)
    spines = [subprocess.Popen(["taskset", "-c", cpu, program, "100"]) for _ in range(2)]
    try:
        for each in spines:
            RobotRig.wait_for(lambda pid=each.pid: Path(f"/proc/{pid}/comm").read_text().strip() == program.name)
        (item,) = [item for item in read((), "--cpu", cpu)["items"] if item["id"] == "spine_pinned"]
        assert item["state"] == "fail"
        assert all(str(each.pid) in item["words"] for each in spines), item["words"]
    finally:
        for each in spines:
            each.kill()
            each.wait()


@pytest.mark.parametrize("words", [("--cpu", "8000"), ("--cpu", "x"), ("--measure", "-1"), ("--measure", "1e9")])
def test_a_core_or_a_time_that_cannot_be_is_an_error(words: tuple[str, str]) -> None:
    done = subprocess.run([BIN / "lithe", "doctor", *words], check=False, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2, done.stdout + done.stderr
    assert done.stdout == "" and done.stderr, "one message, on stderr"


def test_the_page_lists_the_same_items() -> None:
    page = (ROOT / "docs/host.md").read_text()
    rows = re.findall(r"^\| (\d+) \| `(\w+)` \|.*\| (boot)? ?\|$", page, re.MULTILINE)
    listed = [(int(number), name, boot == "boot") for number, name, boot in rows]
    assert listed == [(item["number"], item["id"], item["reboot"]) for item in read(())["items"]]


def test_the_text_begins_with_the_tier() -> None:
    done = subprocess.run([BIN / "lithe", "doctor", "--all"], check=False, capture_output=True, text=True, timeout=60)
    lines = done.stdout.splitlines()
    assert lines[0].startswith("tier ") and ": core " in lines[0], lines[0]
    assert "not applicable" in lines[-1], lines[-1]
    assert all(f" {name}: " in done.stdout for name in states(read(()))), done.stdout
