# SPDX-License-Identifier: Apache-2.0
"""`make boards`: what its verdicts accept and refuse, what it boots, and what it says where nothing can be booted. The
boards themselves: tools/vm/boards.py."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from vm import board_systems, board_x, boards, debian, machine, on_board
from vm.machine import ROOT, Step
from vm.verdict import Skipped, Verdict

LINE = "isolcpus=managed_irq,domain,1,3 nohz_full=1"
CPUS = {"spine": 1, "spine_core": {"isolation": "boot", "words": "isolated at boot (isolcpus)"}}
NAMES = ("spine_pinned", "domain_isolation", "isolated_partition", *(f"item_{n}" for n in range(4, board_x.ITEMS + 1)))
ITEMS = [{"id": name, "state": "ok"} for name in NAMES]
SCRIPT = "".join(f"{name} ok\n" for name in NAMES)  # what the shell script says of the same machine
IRQ = "/proc/irq/4/smp_affinity_list"


def steps(**told: Any) -> dict[str, Step]:
    """Steps that ended well, each with a text, or a document."""
    return {
        name.replace("_", "-"): Step(0, f"\n{each if isinstance(each, str) else json.dumps(each)}\n")
        for name, each in told.items()
    }


def tuned(**changes: Any) -> list[str]:
    """What is wrong with a boot of board x."""
    right = {
        "cmdline": f"console=ttyS0 {LINE}",
        "isolated": "1,3",
        "doctor": {"label": "A-v", "items": ITEMS},
        "expected": SCRIPT,
        "doctor_beside": {"label": "A-v", "items": ITEMS},
        "status": {"cpus": CPUS},
        "threads": "Cpus_allowed_list:\t0\nCpus_allowed_list:\t1",
        "plan": {"changes": [{"item": "irq_default"}]},
        "settings": f"{IRQ} 0-3\n/proc/sys/vm/stat_interval 1",
        "apply": {"steps": [{"kind": "setting", "path": IRQ, "outcome": "done"}]},
        "settings_tuned": f"{IRQ} 0,2\n/proc/sys/vm/stat_interval 1",
        "settings_after": f"{IRQ} 0-3\n/proc/sys/vm/stat_interval 1",
        "files_after": "d41d8cd98f00b204e9800998ecf8427e  /etc/default/grub",
    }
    verdict = Verdict("x")
    board_x.judge_tuned(verdict, steps(**right | changes), LINE, {"etc/default/grub": b"", "etc/debian_version": b"12"})
    return verdict.wrong


def test_a_board_that_is_as_it_must_be_passes() -> None:
    assert tuned() == []


@pytest.mark.parametrize(
    ("changes", "wrong"),
    [
        ({"doctor": {"label": "B-v", "missing": [{"id": "tickless", "words": "it ticks"}]}}, "tickless: it ticks"),
        ({"expected": SCRIPT.replace("item_9 ok", "item_9 warn")}, "{'item_9': ('warn', 'ok')}"),
        ({"expected": SCRIPT.replace("item_9 ok\n", "")}, "{'item_9': (None, 'ok')}"),
        ({"doctor": {"label": "A-v", "items": ITEMS[1:]}}, "{'spine_pinned': ('ok', None)}"),
        ({"doctor": {"label": "A-v", "items": []}, "expected": ""}, "0 items"),
        ({"doctor_beside": {"label": "D-v", "items": ITEMS}}, "beside a robot: tier D-v"),
        ({"cmdline": "console=ttyS0"}, "not booted with"),
        ({"isolated": ""}, "isolated:"),
        ({"status": {"cpus": CPUS | {"spine": 0}}}, "not on an isolated core"),
        ({"threads": "Cpus_allowed_list:\t0-3"}, "no thread of the Spine"),
        ({"plan": {"changes": [{"item": "boot_line"}]}}, "not content with the boot line"),
        ({"settings_after": f"{IRQ} 0,2"}, f"not given back by revert: {IRQ}"),
        ({"apply": {"steps": []}}, "apply changed no setting"),
        ({"settings_tuned": f"{IRQ} 0-3"}, f"apply said done, and did not change: {IRQ}"),
        ({"settings_tuned": ""}, "nobody looked at the settings after apply"),
        ({"settings": "", "settings_after": ""}, "nobody looked at the settings before apply"),
        ({"plan": "a message of the kernel {"}, "not content with the boot line"),
        ({"files_after": "d41d8cd98f00b204e9800998ecf8427e  /etc/default/grub.d/99-lithe.cfg"}, "files after revert"),
    ],
)
def test_a_board_that_is_otherwise_fails_with_the_reason(changes: dict[str, Any], wrong: str) -> None:
    assert any(wrong in sentence for sentence in tuned(**changes)), tuned(**changes)


def partition(tier: str, script: str = SCRIPT) -> list[str]:
    """What is wrong with the boot without isolcpus, when the doctor ends with this tier, and the script says this."""
    right = {
        "isolated": "",
        "doctor_before": {"label": "D-v", "items": ITEMS},
        "doctor_partition": {"label": "B-v", "items": ITEMS},
        "doctor_tuned": {"label": tier, "items": ITEMS},
        "expected_before": SCRIPT,
        "expected_partition": SCRIPT,
        "expected_tuned": script,
        "status": {"cpus": {"spine": 1, "spine_core": {"isolation": "cpuset"}}},
        "settings": f"{IRQ} 0-3",
        "apply": {"steps": [{"kind": "setting", "path": IRQ, "outcome": "done"}]},
        "settings_tuned": f"{IRQ} 0,2",
        "settings_after": f"{IRQ} 0-3",
    }
    verdict = Verdict("x")
    board_x.judge_partition(verdict, steps(**right))
    return verdict.wrong


def test_a_partition_is_tier_b_and_nothing_else() -> None:
    assert partition("B-v") == []
    assert [tier for tier in ("A-v", "C-v", "D-v", "B") if partition(tier)] == ["A-v", "C-v", "D-v", "B"]
    assert partition("B-v", SCRIPT.replace("item_9 ok", "item_9 fail"))


def one_core(**changes: Any) -> list[str]:
    """What is wrong with the boot with one core."""
    right = {
        "online": "0",
        "doctor": {"label": "D-v", "items": ITEMS},
        "expected": SCRIPT,
        "refused_plan": {"error": {"message": "this machine has one core: ...", "next": "nothing to tune"}},
        "refused_shield": "no shield: the Spine has no core of its own here",
        "status": {"cpus": {"spine": 0}},
        "settings": f"{IRQ} 0",
        "settings_after": f"{IRQ} 0",
    }
    verdict = Verdict("x")
    board_x.judge_one_core(verdict, steps(**right | changes))
    return verdict.wrong


@pytest.mark.parametrize(
    "changes",
    [
        {"online": "0-3"},
        {"doctor": {"label": "B-v", "items": ITEMS}},
        {"expected": SCRIPT.replace("item_9 ok", "item_9 fail")},
        {"refused_plan": {"error": {"message": "this machine has one core", "next": "lithe tune plan --cores 1"}}},
        {"refused_plan": {"changes": []}},
        {"refused_shield": "robot arm runs"},
        {"status": {}},
        {"settings_after": f"{IRQ} 1"},
        {"settings": "", "settings_after": ""},
    ],
)
def test_on_one_core_all_that_cannot_be_is_refused_and_a_robot_runs(changes: dict[str, Any]) -> None:
    assert one_core() == []
    assert len(one_core(**changes)) == 1


LAWS = ("constant_torque", "gravity_pd", "hold", "impedance", "lqr", "pd", "reflex")
SWAPS = {
    "swaps": {law: {"verdict": "committed", "slots": [1], "seconds": 13.0} for law in LAWS},
    "loader": "arena",
    "same_spine": True,
    "mode": "active",
    "certificates": 8,
}
RIGHT: dict[str, Any] = {
    "robot": {"mode": "active"},
    "swaps": SWAPS,
    "brain": {"seen_rad": [0.31, -0.28, 0.0], "mode": "active"},
    "stop": {"code": 0},
    "kernel": {"machine": "aarch64", "cores": 4},
    "tests": {
        "failures": [],
        "tests": {name: {"passed": least, "failed": 0, "skipped": 1} for name, least in board_systems.TESTS.items()},
        "skipped_because": [*board_systems.SKIPS],
    },
    "stress": {"rooms": {room: {"code": 0, "passed": [5] * on_board.REPEATS} for room in board_systems.races()}},
    "refused": {
        "laws": {law: {"refused": "trial_failed", "wanted": ["trial_failed"]} for law in on_board.REFUSED},
        "same_spine": True,
        "mode": "active",
    },
    "contained": {
        "laws": {law: {"as_said": True, "kinds": [], "wanted": "clamp"} for law in on_board.CONTAINED},
        "same_spine": True,
        "mode": "active",
    },
    "demo": {
        "verdict": "falls_short",
        "falls_short": ["in the run 11 of 100 releases were missed (11.00%), 0 of these while the machine had ..."],
        "stopped": None,
        "swaps": [1, 2, 3, 4, 5],
    },
}


def but(step: str, part: str, key: str, value: Any) -> dict[str, Any]:
    """What a step of RIGHT tells, with another value for a key of a part of it; without that key for None."""
    told = {**RIGHT[step][part], key: value}
    return {step: RIGHT[step] | {part: {name: each for name, each in told.items() if each is not None}}}


def system(changes: dict[str, Any], code: int = 0) -> list[str]:
    """What is wrong with board a when it has said this."""
    told = RIGHT | changes
    said = "".join(
        f"vm: begin {name}\r\n{json.dumps(each)}\r\nvm: end {name} {code}\r\n" for name, each in told.items()
    )
    verdict = Verdict("a")
    seen = board_systems.Seen(verdict, said, tuple(told))
    board_systems.judge_common(seen)
    board_systems.judge_arm(seen)
    return verdict.wrong


def test_a_system_on_which_all_works_passes() -> None:
    assert system({}) == []


@pytest.mark.parametrize(
    "changes",
    [
        {"robot": {"mode": "disarmed"}},
        {"swaps": SWAPS | {"swaps": {"pd": SWAPS["swaps"]["pd"]}}},  # type: ignore[index]
        {"swaps": SWAPS | {"loader": "dlopen"}},
        {"swaps": SWAPS | {"same_spine": False}},
        {"brain": {"seen_rad": [0.0, 0.01, 0.0], "mode": "active"}},
        {"stop": {"code": 3}},
        {"kernel": {"machine": "x86_64", "cores": 4}},
        {"tests": RIGHT["tests"] | {"failures": ["Ring.Holds"]}},
        {"tests": RIGHT["tests"] | {"skipped_because": ["it is Monday"]}},
        but("tests", "tests", "ipc_tests", {"passed": 1, "failed": 0, "skipped": 50}),
        but("tests", "tests", "law_tests", None),
        but("stress", "rooms", "law", None),
        but("stress", "rooms", "ipc", {"code": 1, "passed": [5] * 9}),
        but("stress", "rooms", "ipc", {"code": 0, "passed": [5] * 9}),
        but("stress", "rooms", "ipc", {"code": 0, "passed": [0] * on_board.REPEATS}),
        but("refused", "laws", "nan_always", {"refused": "committed", "wanted": ["trial_failed"]}),
        but("refused", "laws", "nan_always", None),
        but("contained", "laws", "nan_delayed", {"as_said": False, "kinds": [], "wanted": "not_finite"}),
        but("contained", "laws", "nan_delayed", None),
        {"contained": RIGHT["contained"] | {"mode": "safe_stop"}},
        {"demo": {"verdict": None, "stopped": None, "swaps": None}},
        {"demo": RIGHT["demo"] | {"inconclusive": ["the frozen Brain was silent for 0.10 s only"]}},
        {"demo": RIGHT["demo"] | {"swaps": [1, 2]}},
    ],
)
def test_a_system_on_which_something_does_not_fails(changes: dict[str, Any]) -> None:
    (name,) = changes
    assert any(sentence.startswith(name) for sentence in system(changes)), system(changes)


DIAGNOSIS: dict[str, Any] = {
    "label": "D-v",
    "items": ITEMS,
    "expected": SCRIPT,
    "kernel": {"words": "6.1.0-56-rt-amd64, PREEMPT_RT"},
}


@pytest.mark.parametrize(
    ("changes", "kernel", "wrong"),
    [
        ({}, {}, ""),
        ({"label": "A-v"}, {}, "doctor: tier A-v, not C-v or D-v"),
        ({"items": ITEMS[1:]}, {}, "38 items of 39"),
        ({"items": [ITEMS[0] | {"state": "fail"}, *ITEMS[1:]]}, {}, "{'spine_pinned': ('ok', 'fail')}"),
        ({"expected": SCRIPT.replace("item_4 ok", "item_4 warn")}, {}, "{'item_4': ('warn', 'ok')}"),
        ({"kernel": {"words": "6.1.0-56-rt-amd64"}}, {}, "it says of the kernel: '6.1.0-56-rt-amd64'"),
        ({"kernel": {"words": "6.1.0-55-rt-amd64, PREEMPT_RT"}}, {}, "it says of the kernel: '6.1.0-55"),
        ({}, {"realtime": False}, "no PREEMPT_RT kernel"),
    ],
)
def test_the_doctor_of_a_system_is_judged_item_by_item(
    changes: dict[str, Any], kernel: dict[str, Any], wrong: str
) -> None:
    told = {"kernel": {"realtime": True} | kernel, "doctor": DIAGNOSIS | changes}
    said = "".join(f"vm: begin {name}\r\n{json.dumps(each)}\r\nvm: end {name} 0\r\n" for name, each in told.items())
    verdict = Verdict("r")
    seen = board_systems.Seen(verdict, said, tuple(told))
    board_systems.judge_doctor(seen, board_systems.UNPREPARED)
    board_systems.judge_rt(seen, machine.Kernel(Path("boot/vmlinuz-6.1.0-56-rt-amd64"), {}))
    assert len(verdict.wrong) == bool(wrong), verdict.wrong
    assert wrong in "".join(verdict.wrong)


def test_a_step_that_failed_or_never_ended_is_named() -> None:
    assert "robot" in system({}, code=1)[0]
    verdict = Verdict("a")
    board_systems.Seen(verdict, "vm: begin robot\n", ("robot", "swaps"))
    assert "robot, swaps" in verdict.wrong[0]


def test_a_hostile_law_ends_as_its_header_says_or_is_reported() -> None:
    ran_on: dict[str, Any] = {"kinds": [], "refused": "", "stopped": "", "clamped": 0}

    def well(want: str, machine: str = "x86_64", **fate: Any) -> bool:
        return on_board.as_said(want, ran_on | fate, machine)

    assert well("bad_access", kinds=["bad_access"])
    assert not well("bad_access")
    assert not well("bad_access", kinds=["overran"])
    assert not well("bad_access", kinds=["tracking_lost"]), "its probation was faster: that shows nothing"
    assert not well("bad_access", refused="dry_run_failed: bad_access"), "it never ran"
    assert well("clamp", clamped=3) and well("clamp", clamped=3, kinds=["tracking_lost"])
    assert not well("clamp"), "the guard had nothing to limit"
    assert not well("clamp", clamped=3, kinds=["bad_access"])
    assert well("arithmetic", kinds=["arithmetic"]) and not well("arithmetic")
    assert well("arithmetic", "aarch64") and not well("arithmetic", "aarch64", kinds=["arithmetic"])
    for name in on_board.REFUSED:
        assert on_board.header(ROOT / f"tests/laws_hostile/{name}.cpp", "stopped-by") in on_board.STAGES
    for name in on_board.CONTAINED:
        law = ROOT / f"tests/laws_hostile/{name}.cpp"
        assert on_board.header(law, "without-gates") and "struct Later" in on_board.later(law.read_text())


def read_archive(data: bytes) -> dict[str, tuple[int, bytes]]:
    """Mode and content of each file of an archive, as the kernel reads it."""
    files, at = {}, 0
    while True:
        fields = [int(data[at + 6 + 8 * n : at + 14 + 8 * n], 16) for n in range(13)]
        name = data[at + 110 : at + 110 + fields[11] - 1].decode()
        start = at + (110 + fields[11] + 3) // 4 * 4
        if name == "TRAILER!!!":
            assert start == len(data)
            return files
        files[name] = (fields[1], data[start : start + fields[6]])
        at = start + (fields[6] + 3) // 4 * 4


def test_a_system_becomes_an_archive_with_its_links_and_without_its_pages(tmp_path: Path) -> None:
    for name in (
        "usr/bin/dash",
        "usr/share/doc/g++/readme",
        "usr/lib/aarch64-linux-gnu/blas/libblas.so.3",
        "usr/bin/gcc",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
    (tmp_path / "bin").symlink_to("usr/bin")
    debian.finish(tmp_path, "arm64")
    data = b"".join(machine.entry(*each) for each in debian.entries(tmp_path)) + machine.END
    files = read_archive(data)
    assert files["usr/bin/dash"][1] == b"usr/bin/dash"
    assert files["bin"] == (0o120777, b"usr/bin")
    assert files["usr/bin/sh"][1] == b"dash" and files["usr/bin/cc"][1] == b"gcc"
    assert files["usr/lib/aarch64-linux-gnu/libblas.so.3"][1] == b"blas/libblas.so.3"
    assert b"root:" in files["etc/passwd"][1]
    assert not any(name.startswith("usr/share/doc") for name in files)
    names = list(files)
    assert all(names.index(str(Path(name).parent)) < names.index(name) for name in names if "/" in name)


def test_the_line_is_the_one_that_grub_would_give(tmp_path: Path) -> None:
    (tmp_path / "etc/default/grub.d").mkdir(parents=True)
    (tmp_path / "etc/default/grub").write_text(board_x.GRUB.replace('LINUX=""', 'LINUX="a"'))
    (tmp_path / "etc/default/grub.d/99-x.cfg").write_text('GRUB_CMDLINE_LINUX="$GRUB_CMDLINE_LINUX b=1"\n')
    assert board_x.boot_line(tmp_path) == "a b=1 quiet"


def test_without_qemu_each_board_is_skipped_with_the_line_to_type(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "tools/vm/boards.py"],
        cwd=ROOT,
        env={"PATH": "/nowhere", "LITHE_OUT_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 77, done.stdout + done.stderr
    said = done.stdout.splitlines()
    packages = ("qemu-system-x86 busybox-static", "qemu-system-x86 busybox-static", "qemu-system-arm busybox-static")
    assert len(said) == 3
    for line, board, names in zip(said, "xra", packages, strict=True):
        assert line.startswith(f"board {board}: skipped in 0 s: ")
        assert line.endswith(f"sudo apt-get install -y --no-install-recommends {names}")
    told = json.loads((tmp_path / "boards.json").read_text())["boards"]
    assert {board: each["verdict"] for board, each in told.items()} == dict.fromkeys("xra", "skipped")


def test_the_packages_it_names_are_in_the_list_of_packages() -> None:
    rows = [line.split()[:2] for line in (ROOT / "tools/packages.txt").read_text().splitlines()]
    listed = {package for group, package in rows if group in ("vcan", "boards")}
    assert listed == {"qemu-system-x86", "qemu-system-arm", "busybox-static"}


def test_a_board_that_breaks_keeps_no_other_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks(*_: object) -> None:
        raise ValueError("no such thing")

    def skips(*_: object) -> None:
        raise Skipped("no QEMU")

    def passes(verdict: Verdict, *_: object) -> None:
        verdict.kernel, verdict.lines = "Debian 6", ["one", "two", "three"]

    monkeypatch.setattr(boards, "BOARDS", {"x": breaks, "r": skips, "a": passes})
    monkeypatch.setattr(boards, "why_not", lambda: "")
    told = [boards.one(name, tmp_path / name, "") for name in "xra"]
    assert [verdict.word for verdict in told] == ["failed", "skipped", "passed"]
    assert "ValueError: no such thing" in told[0].text()
    assert told[2].text().splitlines()[0] == "board a: passed in 0 s: Debian 6" and told[2].text().count("\n") == 3
    assert [boards.exit_code(some) for some in (told, told[1:], told[1:2])] == [1, 0, 77]
    assert os.listdir(tmp_path)
