# SPDX-License-Identifier: Apache-2.0
"""Boards r and a: a whole Debian system in memory, with a compiler and Python, on another kernel or processor."""

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cross
from vm import board_x, debian, machine, on_board
from vm.board_x import LAW, PATIENCE, kernel_of, need
from vm.machine import HOME, LITHE, ROOT, Architecture, Cargo, changed
from vm.verdict import Skipped, Verdict, document

SCRIPT = Path(__file__).with_name("on_board.sh")
PROGRAM = Path(__file__).with_name("on_board.py")
STEPS_R = ("kernel", "doctor", "robot", "swaps", "brain", "stop")
# Two boots, each within ON_BOARD_S: the tests take as long as everything else.
STEPS_TESTS = (*STEPS_R[:2], "tests", "stress")
STEPS_ROBOT = (*STEPS_R[2:5], "refused", "contained", "stop", "demo")
STEPS_A = (*STEPS_TESTS, *STEPS_ROBOT)
UNPREPARED = ("C-v", "D-v")  # tiers of a virtual machine on which nothing was set
# The rooms whose tests ask for what qemu-user does not have (docs/arm64.md), or for the order of memory; and how many
# tests must pass at least.
TESTS = {"arena_tests": 13, "contain_tests": 70, "ipc_tests": 55, "law_tests": 32, "load_tests": 33, "trial_tests": 45}
# What a Cortex-A72, its kernel and this small system lack: no test may skip itself for another reason.
SKIPS = (
    "protection keys",
    "this kernel has no such gate",
    "not every AArch64 core can trap on arithmetic",
    "MuJoCo cannot be loaded",
    "takes too long to simulate",
)
TIMING = " releases were missed ("  # in each sentence of the demo's verdict that is about time, which says nothing here
SWAPS = 5  # of the demo
SPINE_CORE = 1  # the robots' choice on a board with four
ROBOTS = ("robot", "contained", "demo")  # the steps that start one
# An arm that goes heavily: a law that pushes cannot carry it past its limits at once.
HEAVY = {
    "torque_max_nm = 0.6 ": "torque_max_nm = 0.3 ",
    "viscous_nm_s_rad = 3.0e-5": "viscous_nm_s_rad = 2.0e-2",
}
# Where files of the tree are on the board: as in an installation, so that nothing needs to be told.
PLACES = {"spine/law/include/lithe": "include/lithe", "host/boards": "share/lithe/boards"}
FOLDERS = ("brain/lithe", "laws", "tests/laws_hostile", *PLACES)
ON_BOARD_S = 1200  # at most, with the boot


def sources() -> dict[str, bytes]:
    """What of the tree a board needs."""
    files = {}
    for folder in FOLDERS:
        for path in (ROOT / folder).rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts and not path.name.endswith("_test.cpp"):
                within = path.relative_to(ROOT / folder)
                files[f"{HOME}/{PLACES.get(folder, folder)}/{within}"] = path.read_bytes()
    calm = changed((ROOT / "robots/arm.toml").read_text(), PATIENCE)
    assert next(iter(LAW)) in calm
    files[f"{HOME}/robots/calm.toml"] = calm.encode()
    files[f"{HOME}/robots/heavy.toml"] = changed(calm, HEAVY).encode()
    files[f"{HOME}/on_board.py"] = PROGRAM.read_bytes()
    files[f"{HOME}/{board_x.DOCTOR.name}"] = board_x.DOCTOR.read_bytes()
    files[f"{HOME}/stress"] = "".join(f"{room} {tests}\n" for room, tests in races().items()).encode()
    return files


def races() -> dict[str, str]:
    """The tests whose threads race, by room: `lithe_stress` (cmake/rooms.cmake) names them."""
    lines = "\n".join(path.read_text() for path in (ROOT / "spine").glob("*/CMakeLists.txt"))
    return dict(re.findall(r'(?m)^lithe_stress\((\w+) "([^"]+)"\)', lines))


def for_tests(folder: Path) -> dict[str, bytes]:
    """What the tests look for where it was when they were built: their laws as objects, and the robot files."""
    found = [*(folder.parent / "lib").glob("*.so"), *(ROOT / "robots").glob("*.toml")]
    return {str(path).lstrip("/"): path.read_bytes() for path in found}


def chosen(steps: tuple[str, ...], only: str) -> tuple[str, ...]:
    """Those of the steps that were asked for. ValueError: this board has no such step."""
    wanted = set(only.split(",")) if only else set(steps)
    if unknown := wanted - set(steps):
        raise ValueError(f"--only {','.join(sorted(unknown))}: no such step; there are {', '.join(steps)}")
    return tuple(step for step in steps if step in wanted)


class Seen:
    """What a board has said, by step."""

    def __init__(self, verdict: Verdict, said: str, names: tuple[str, ...], boot: str = "steps") -> None:
        """Keep in the verdict which steps failed, and, under the name of this boot, what they told."""
        self.verdict, self.names = verdict, names
        steps = machine.steps(said)
        verdict.expect_steps((name for name in names if name not in steps or steps[name].code != 0), "board", said)
        self.told: dict[str, dict[str, Any]] = {name: document(steps, name) for name in names}
        verdict.facts[boot] = self.told
        for name in names:
            ended = name in steps and steps[name].code == 0
            verdict.expect(not ended or bool(self.get(name)), f"{name}: it ended, and its document cannot be read")

    def get(self, name: str) -> dict[str, Any]:
        """The document of a step; empty if it was not taken, or failed."""
        told = self.told.get(name, {})
        return {} if "error" in told else told

    def expect(self, name: str, is_so: bool, sentence: str) -> None:
        """Something that holds if that step was taken and ended."""
        if self.get(name):
            self.verdict.expect(is_so, f"{name}: {sentence}")


def judge_doctor(seen: Seen, tiers: tuple[str, ...]) -> None:
    """Every item is as a shell script reads it, and the tier is one of these."""
    if told := seen.get("doctor"):
        board_x.expect_items(seen.verdict, "doctor", told, str(told.get("expected", "")))
        label = told.get("label")
        sentence = f"tier {label}, not {' or '.join(tiers)}; missing: {board_x.missing(told)}"
        seen.expect("doctor", label in tiers, sentence)


def judge_common(seen: Seen) -> None:
    """What holds on every board."""
    status, swaps, brain = seen.get("robot"), seen.get("swaps"), seen.get("brain")
    seen.expect("robot", status.get("mode") == "active", f"mode {status.get('mode')}")
    made = swaps.get("swaps", {})
    bad = {law: each for law, each in made.items() if each["verdict"] != "committed"}
    seen.expect("swaps", not bad and len(made) >= 7, f"{len(made)} laws, not committed: {bad}")
    placed = swaps.get("loader") == "arena" and all(None not in each["slots"] for each in made.values())
    seen.expect("swaps", placed, f"laws are not in the arena: {swaps.get('loader')}, {made}")
    seen.expect("swaps", swaps.get("same_spine") is True and swaps.get("mode") == "active", f"the Spine: {swaps}")
    # How near depends on how many ticks a loaded computer lets pass: only that the joint follows is asked.
    there_rad, back_rad = (brain.get("seen_rad") or [0.0, 0.0])[:2]
    follows = there_rad - back_rad > 0.3 and brain.get("mode") == "active"
    seen.expect("brain", follows, f"the joint did not go where plans said: {brain}")
    seen.expect("stop", seen.get("stop").get("code") == 0, f"`lithe run` ended with {seen.get('stop').get('code')}")


def with_result(*lines: tuple[Any, str]) -> list[str]:
    """Each line whose step has a result; of the others only that there is none."""
    return [line if told else f"{line.split(':')[0]}: no result" for told, line in lines]


def swap_line(seen: Seen) -> str:
    """What became of the laws, for people."""
    swaps, made = seen.get("swaps"), seen.get("swaps").get("swaps", {})
    committed = [law for law, each in made.items() if each["verdict"] == "committed"]
    took = sorted(each["seconds"] for each in made.values()) or [0.0]
    return (
        f"swaps: {len(committed)} of {len(made)} laws committed ({', '.join(committed)}) in the {swaps.get('loader')}, "
        f"{took[0]:.0f} to {took[-1]:.0f} s each; {swaps.get('certificates')} certificates, chain holds"
    )


def start(
    verdict: Verdict, cargo: Cargo, kernel: machine.Kernel, cache: Path, names: tuple[str, ...], boot: str = "steps"
) -> Seen:
    """Boot, and read what was said."""
    said = machine.boot(kernel, cargo, cache)
    (cache / f"{boot}.log").write_text(said)
    return Seen(verdict, said, names, boot)


def cargo_for(architecture: Architecture, programs: tuple[Path, ...], cache: Path, names: tuple[str, ...]) -> Cargo:
    """A system with these programs, that takes these steps."""
    files = {**sources(), **for_tests(programs[0].parent), f"{HOME}/steps": " ".join(names).encode()}
    system = debian.get_system(architecture.debian, cache)
    spine_core = SPINE_CORE if set(ROBOTS) & set(names) else None  # tests that race need all cores of this computer
    return Cargo(
        SCRIPT, programs, files, (), system, architecture, 4, spine_core, memory_mib=4096, timeout_s=ON_BOARD_S
    )  # fmt: skip


def told_kernel(diagnosis: dict[str, Any]) -> str:
    """Which kernel the doctor says it has found."""
    return str(diagnosis.get("kernel", {}).get("words", ""))


def judge_rt(seen: Seen, kernel: machine.Kernel) -> None:
    """The kernel is the one that was meant, and the doctor names it."""
    about, words = seen.get("kernel"), told_kernel(seen.get("doctor"))
    seen.expect("kernel", about.get("realtime") is True, f"no PREEMPT_RT kernel: {about}")
    seen.expect("doctor", kernel.release in words and "PREEMPT_RT" in words, f"it says of the kernel: {words!r}")


def run_isolated(verdict: Verdict, cargo: Cargo, kernel: machine.Kernel, cache: Path) -> str:
    """What the doctor says on the same kernel, booted with the line of `lithe tune`; its tier."""
    board_x.make_image(cache / "image", kernel)
    board_x.tune("apply", cache / "image", "--cores", board_x.CORES)
    line = board_x.boot_line(cache / "image")
    names = STEPS_R[:2]
    files = {**cargo.files, f"{HOME}/steps": " ".join(names).encode()}
    seen = start(verdict, replace(cargo, options=line, files=files), kernel, cache, names, "isolated")
    judge_rt(seen, kernel)
    judge_doctor(seen, ("A-v",))
    return str(seen.get("doctor").get("label"))


def rt_lines(seen: Seen, isolated: str) -> list[str]:
    """For people. `isolated`: the tier with the line of `lithe tune`."""
    robot, diagnosis, brain = seen.get("robot"), seen.get("doctor"), seen.get("brain")
    doctor = (
        f"kernel {told_kernel(diagnosis)}, tier {diagnosis.get('label')}, booted with the line of `lithe tune` "
        f"{isolated}; all {board_x.ITEMS} items as a shell script reads them"
    )
    return with_result(
        (diagnosis, f"doctor: {doctor}"),
        (robot, f"lithe run: {robot.get('mode')}, Spine on core {robot.get('cpus', {}).get('spine')}"),
        (brain, f"plans from Python: {brain.get('seen_rad')} rad of {brain.get('wanted_rad')}"),
        (seen.get("swaps"), swap_line(seen)),
    )


def run_r(verdict: Verdict, cache: Path, only: str) -> None:
    """Debian's PREEMPT_RT kernel: a robot on it; then the doctor where cores are isolated."""
    kernel = kernel_of("linux-image-rt-amd64", machine.AMD64, cache)
    verdict.kernel = f"Debian {kernel.release}, 4 cores"
    names = chosen(STEPS_R, only)
    cargo = cargo_for(machine.AMD64, need(LITHE), cache, names)
    seen = start(verdict, cargo, kernel, cache, names)
    judge_rt(seen, kernel)
    judge_doctor(seen, UNPREPARED)
    judge_common(seen)
    isolated = run_isolated(verdict, cargo, kernel, cache) if "doctor" in names else ""
    verdict.lines += rt_lines(seen, isolated)


def build_arm(programs: tuple[str, ...]) -> Path:
    """These programs of the cross-built release; their folder."""
    if lacking := cross.missing():
        raise Skipped(f"sudo apt-get install -y --no-install-recommends {' '.join(lacking)}")
    cross.get_sysroot()
    cross.run(["cmake", "--preset", "aarch64", "--log-level=WARNING"], "cmake")
    jobs = str(len(os.sched_getaffinity(0)))
    cross.run(["cmake", "--build", "--preset", "aarch64", "-j", jobs, "--target", *programs], "the build")
    return ROOT / "build/aarch64/bin"


def judge_tests(seen: Seen) -> None:
    """Enough tests passed, each that did not run said why, and those that race did so again and again."""
    tests, rooms = seen.get("tests"), seen.get("stress").get("rooms", {})
    seen.expect("tests", not tests.get("failures"), f"failed: {tests.get('failures')}")
    few = {
        program: count
        for program, least in TESTS.items()
        if (count := tests.get("tests", {}).get(program, {}).get("passed", 0)) < least
    }
    seen.expect("tests", not few, f"fewer passed than {TESTS}: {few}")
    odd = [why for why in tests.get("skipped_because", []) if not any(words in why for words in SKIPS)]
    seen.expect("tests", not odd, f"skipped for a reason that does not hold here: {odd}")
    bad = {
        room: each
        for room, each in rooms.items()
        if each["code"] != 0 or len(each["passed"]) != on_board.REPEATS or min(each["passed"]) < 1
    }
    seen.expect("stress", set(rooms) == set(races()) and not bad, f"rooms {sorted(rooms)}, not as they must be: {bad}")


def judge_arm(seen: Seen) -> None:
    """What only board a is asked for."""
    about = seen.get("kernel")
    seen.expect("kernel", about.get("machine") == "aarch64" and about.get("cores") == 4, f"no such board: {about}")
    judge_tests(seen)
    for name, wanted in (("refused", on_board.REFUSED), ("contained", on_board.CONTAINED)):
        told = seen.get(name)
        laws = told.get("laws", {})
        seen.expect(name, set(laws) == set(wanted), f"laws without an end: {sorted(set(wanted) - set(laws))}")
        seen.expect(
            name, told.get("same_spine") is True and told.get("mode") == "active", f"the robot after it: {told}"
        )
    refused = seen.get("refused").get("laws", {})
    otherwise = {law: each for law, each in refused.items() if each["refused"] not in each["wanted"]}
    seen.expect("refused", not otherwise, f"not refused where they must be: {otherwise}")
    escaped = {law: fate for law, fate in seen.get("contained").get("laws", {}).items() if not fate["as_said"]}
    seen.expect("contained", not escaped, f"ended otherwise: {escaped}")
    demo = seen.get("demo")
    wrong = [each for key in ("falls_short", "inconclusive") for each in demo.get(key) or [] if TIMING not in each]
    ended = demo.get("verdict") in ("holds", "falls_short", "INCONCLUSIVE") and not demo.get("stopped")
    swaps = len(demo.get("swaps") or [])
    seen.expect("demo", ended and not wrong and swaps == SWAPS, f"{swaps} swaps; apart from timing: {wrong}; {demo}")


def arm_lines(seen: Seen) -> list[str]:
    """For people."""
    tests, rooms, diagnosis = seen.get("tests"), seen.get("stress").get("rooms", {}), seen.get("doctor")
    sums = {
        kind: sum(each[kind] for each in tests.get("tests", {}).values()) for kind in ("passed", "failed", "skipped")
    }
    refused, laws = seen.get("refused").get("laws", {}), seen.get("contained").get("laws", {})
    kinds = sorted({kind for fate in laws.values() for kind in fate["kinds"]})
    clamped = [law for law, fate in laws.items() if fate["wanted"] == "clamp" and fate["as_said"]]
    demo, brain = seen.get("demo"), seen.get("brain")
    counts = f"{sums['passed']} passed, {sums['failed']} failed, {sums['skipped']} skipped"
    ends = f"faults contained: {', '.join(kinds)}; limited by the guard: {', '.join(clamped)}"
    return with_result(
        (tests, f"C++ tests: {counts} ({'; '.join(tests.get('skipped_because', []))})"),
        (rooms, f"tests that race, {on_board.REPEATS} times: {', '.join(rooms)}"),
        (diagnosis, f"doctor: kernel {told_kernel(diagnosis)}, tier {diagnosis.get('label')}"),
        (seen.get("swaps"), swap_line(seen)),
        (brain, f"plans from Python: {brain.get('seen_rad')} rad"),
        (refused, f"hostile laws with closed gates: {len(refused)} refused"),
        (laws, f"hostile laws with open gates: {len(laws)} ran ({ends})"),
        (demo, f"demo at 250 Hz: {demo.get('verdict')}, {len(demo.get('swaps') or [])} swaps"),
    )


def run_a(verdict: Verdict, cache: Path, only: str) -> None:
    """Debian for 64-bit ARM on four emulated Cortex-A72."""
    if lacking := machine.missing_tools(machine.ARM64):
        raise Skipped(f"sudo apt-get install -y --no-install-recommends {' '.join(lacking)}")
    names = chosen(STEPS_A, only)
    wanted = (*LITHE, *(TESTS if {"tests", "stress"} & set(names) else ()))
    programs = need(wanted, build_arm(wanted))
    kernel = kernel_of("linux-image-arm64", machine.ARM64, cache)
    verdict.kernel = f"Debian {kernel.release}, 4 emulated Cortex-A72"
    boots = [
        start(verdict, cargo_for(machine.ARM64, programs, cache, steps), kernel, cache, steps, boot)
        for boot, group in (("tests", STEPS_TESTS), ("robot", STEPS_ROBOT))
        if (steps := tuple(name for name in group if name in names))
    ]
    seen = boots[0]
    seen.told = {name: told for boot in boots for name, told in boot.told.items()}
    judge_doctor(seen, UNPREPARED)
    judge_common(seen)
    judge_arm(seen)
    verdict.lines += arm_lines(seen)
