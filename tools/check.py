# SPDX-License-Identifier: Apache-2.0
"""Everything `make check` asks for, cheapest first. Names on the command line pick steps; --fix repairs what it can."""

import argparse
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
PYTHON = ".venv/bin/python"
JOBS = str(len(os.sched_getaffinity(0)))
SKIPPED = 77  # the exit code of a step that this machine cannot run; it has said why
CPP_FILES = "git ls-files -co --exclude-standard '*.cpp' '*.hpp' '*.c' '*.h' | grep -v ^spine/wire/"
# What must be free of data races, and what runs in the tick (cmake/rooms.cmake labels every test with its room).
# In `contain` ThreadSanitizer sees the words that FaultBarrier and Watchdog share; it holds asynchronous signals
# back and wants faults for itself, so tests of those skip themselves there (spine/contain/test/contain_rig.hpp). In the
# rooms of buses it sees the Link between exchange and housekeeping.
RACE_ROOMS = "ipc law load loop contain hal_core hal_bus_serial hal_bus_fdcanusb hal_bus_slcan hal_bus_socketcan"
RACE_TESTS = f"(^|[.])({RACE_ROOMS.replace(' ', '|')})$"

# Whose tests run whole ticks, those of real drivers among them. The drivers' own tests take longer to compile than all
# of these: they are in `rtsan-all`, as everything that runs in the tick.
TICK_ROOMS = "ipc law plan guard step loop contain"
TICK_TESTS = f"^tick[.]({TICK_ROOMS.replace(' ', '|')})$"

# What shares the process of the tick, or reads bytes that others wrote into it. The other rooms (supervisor, lawd,
# trial) run under AddressSanitizer in `asan-all`: building them takes longer than all of this.
MEMORY_ROOMS = "load arena robot"
MEMORY_TARGETS = "tick_tests fuzzers " + " ".join(f"{room}_tests" for room in MEMORY_ROOMS.split())
MEMORY_TESTS = f"^(tick[.].*|{MEMORY_ROOMS.replace(' ', '|')})$"
# What the processor decides (words, memory, signals, new code) and what goes over a wire. All other rooms have their
# tests run as ARM code in `arm64-all`.
ARM_ROOMS = "core wire ipc arena law load contain guard hal hal_core hal_canopen hal_cia401 hal_cia402 hal_gateway"
ARM_ROOMS += " hal_moteus hal_bus_fdcanusb hal_bus_serial hal_bus_slcan hal_bus_socketcan"
RT_FIX = 'ctest --preset rtsan -R NAME; a call that must stay needs LITHE_RT_EXEMPT("why bounded", ...)'
FOUND = "of a fuzzer the command behind `again:`, then a test of its own for what it found"
BOARD_TARGETS = "lithe lithe-spine lithe-spine-sim lawd lithe-trial lithe-sim"


@dataclass(frozen=True)
class Step:
    """One check: the command that asks, and the command that mends (or shows more)."""

    name: str
    command: str
    fix: str
    long: bool = False  # only with --all (`make check-all`): it takes too long for every merge


def build(preset: str, targets: str = "") -> str:
    """Configure and build one preset."""
    only = f" --target {targets}" if targets else ""
    return f"cmake --preset {preset} --log-level=WARNING && cmake --build --preset {preset} -j {JOBS}{only}"


STEPS = [
    Step(
        "rooms",
        f"{PYTHON} tools/rooms.py",
        "the table ALLOWED in tools/rooms.py says who may include whom; ARCHITECTURE.md names every room",
    ),
    Step("lint", f"{PYTHON} tools/lint.py", "each line above says what to do"),
    Step("paper", f"{PYTHON} tools/paper.py", "each line above says what a page names and does not exist"),
    Step("schema", f"{PYTHON} tools/gen.py --check", f"{PYTHON} tools/gen.py --write"),
    Step("ruff", f"{PYTHON} -m ruff check --quiet . && {PYTHON} -m ruff format --check --quiet .", "make format"),
    Step("types", f"{PYTHON} -m mypy --no-error-summary", f"{PYTHON} -m mypy"),
    Step("models", f"{PYTHON} tools/models.py", f"{PYTHON} tools/models.py --trace RUN models/FILE.pml tells how"),
    Step("format", f"{CPP_FILES} | xargs clang-format-22 --dry-run -Werror", "make format"),
    Step(
        "tidy",
        f"cmake --preset clang --log-level=WARNING && {PYTHON} tools/tidy.py -j {JOBS}",
        "clang-tidy-22 -p build/clang --fix FILE",
    ),
    Step(
        "rtsan",
        f"{build('rtsan', ' '.join(f'{room}_tests' for room in TICK_ROOMS.split()))}"
        f" && ctest --preset rtsan -L '{TICK_TESTS}' -j {JOBS}",
        RT_FIX,
    ),
    Step(
        "tsan",
        f"{build('tsan', ' '.join(f'{room}_tests' for room in RACE_ROOMS.split()))}"
        f" && ctest --preset tsan -L '{RACE_TESTS}' -j {JOBS}",
        "ctest --preset tsan -R NAME shows both sides of the race; no suppressions",
    ),
    Step(
        "asan",
        f"{build('asan', MEMORY_TARGETS)} && ctest --preset asan -L '{MEMORY_TESTS}' -j {JOBS}"
        f" && {PYTHON} tools/fuzz.py",
        f"ctest --preset asan -R NAME; {FOUND}",
    ),
    Step(
        "arm64",
        f"{PYTHON} tools/cross.py --jobs {JOBS} --room {ARM_ROOMS}",
        "make test-arm64 ROOM=guard repeats one room's tests (docs/arm64.md)",
    ),
    Step(
        "rtsan-all", f"{build('rtsan', 'tick_tests')} && ctest --preset rtsan -L '^tick' -j {JOBS}", RT_FIX, long=True
    ),
    Step("asan-all", f"{build('asan')} && ctest --preset asan -j {JOBS}", "ctest --preset asan -R NAME", long=True),
    Step(
        "mutants",
        f"{build('release', 'mutants')} && ctest --preset mutants -j {JOBS}",
        "ctest --preset mutants -R NAME; tests/fuzz/mutants.cmake has the lines",
        long=True,
    ),
    Step(
        "fuzz-long",
        f"{build('asan', 'fuzzers')} && {PYTHON} tools/fuzz.py --seconds 60 --jobs {JOBS}",
        FOUND,
        long=True,
    ),
    Step(
        "arm64-all",
        f"{PYTHON} tools/cross.py --jobs {JOBS}",
        "make test-arm64 ROOM=guard repeats one room's tests (docs/arm64.md)",
        long=True,
    ),
    Step(
        "boards",
        f"{build('release', BOARD_TARGETS)} && {PYTHON} tools/vm/boards.py",
        "make boards BOARD=x repeats one board; build/boards/x/*.log is what it said",
        long=True,
    ),
    Step("debian13", "tools/vm/debian13", "tools/vm/debian13 'cd /lithe && bash' repeats it by hand", long=True),
    Step(
        "ctest-long",
        f"{build('release', 'loop_tests limits_tests')} && for tests in loop_tests limits_limits; do "
        "build/release/bin/$tests --gtest_also_run_disabled_tests --gtest_filter='*.DISABLED_*' || exit 1; done",
        "the same command",
        long=True,
    ),
    Step(
        "pytest-long",
        f"{build('bench')} && {PYTHON} -m pytest -m long",  # one of them runs the isolation bench
        f"{PYTHON} -m pytest -m long -x -k NAME",
        long=True,
    ),
]
FIXES = [
    f"{PYTHON} -m ruff check --quiet --fix .; {PYTHON} -m ruff format --quiet .",
    f"{CPP_FILES} | xargs clang-format-22 -i",
]


def run(step: Step) -> str:
    """Run one step; show what it printed only when that matters. What it came to: "ok", "skip", or "" for a failure."""
    started = time.monotonic()
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", step.command], cwd=ROOT, capture_output=True, text=True, check=False
    )
    taken = time.monotonic() - started
    end = {0: "ok", SKIPPED: "skip"}.get(done.returncode, "")
    said = done.stdout[-20000:] + done.stderr[-20000:] if end != "ok" else done.stdout if step.name == "lint" else ""
    verdict = f"{end or 'FAIL':<4} {step.name:<8} {taken:6.1f} s" + ("" if end else f"   to fix: {step.fix}")
    print(f"{said}{verdict}\n", end="", flush=True)
    return end


def chosen(names: list[str], everything: bool) -> list[Step]:
    """Return the named steps; without names all that are not long, or all there are."""
    if names:
        return [step for step in STEPS if step.name in names]
    return [step for step in STEPS if everything or not step.long]


def main() -> int:
    """Run the steps that were asked for; each of them, even after a failure, so that one run tells everything."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("steps", nargs="*", metavar="STEP", help=" ".join(step.name for step in STEPS))
    parser.add_argument("--fix", action="store_true", help="repair what a machine can decide")
    parser.add_argument("--all", action="store_true", help="the long steps too")
    args = parser.parse_args()
    if args.fix:
        return max(subprocess.run(["bash", "-c", fix], cwd=ROOT, check=False).returncode for fix in FIXES)
    wanted = chosen(args.steps, everything=args.all)
    unknown = set(args.steps) - {step.name for step in STEPS}
    if unknown:
        parser.error(f"no such step: {', '.join(sorted(unknown))}")
    # Two at a time: some are one process for minutes, and while a build links, or is configured, a core is free.
    # The long ones start robots, which need the machine, and share their builds.
    short, long = ([step for step in wanted if step.long is which] for which in (False, True))
    with ThreadPoolExecutor(2) as pool:
        ends = dict(zip((step.name for step in short), pool.map(run, short), strict=True))
    ends |= {step.name: run(step) for step in long}
    failed, skipped = ([name for name, end in ends.items() if end == which] for which in ("", "skip"))
    print(
        f"check: {len(wanted) - len(failed) - len(skipped)} of {len(wanted)} passed"
        + (f", skipped: {' '.join(skipped)}" if skipped else "")
        + (f", failed: {' '.join(failed)}" if failed else "")
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
