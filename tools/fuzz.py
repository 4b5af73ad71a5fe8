# SPDX-License-Identifier: Apache-2.0
"""Runs the fuzzers of tests/fuzz that the preset `asan` has built: their seeds, then so many seconds of their own.

What a fuzzer learns stays in build/asan/corpus/TARGET, and the next run starts from there. An input that breaks
something stays in build/asan/found/TARGET; `build/asan/bin/fuzz_TARGET FILE` shows it again.
"""

import argparse
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

BUILD = Path(__file__).parent.parent / "build/asan"
STRICT = {
    "ASAN_OPTIONS": "detect_stack_use_after_return=1:strict_string_checks=1",
    "UBSAN_OPTIONS": "halt_on_error=1:print_stacktrace=1",
}
LONGEST_RUN_S = 10  # of one input: what takes longer hangs
LONGEST_INPUT = 4096
REASON = re.compile(r"^(refuted: .*|.*runtime error: .*|SUMMARY: .*)$", re.M)


def targets(build: Path) -> list[str]:
    """The fuzzers that are there."""
    return sorted(file.name.removeprefix("fuzz_") for file in build.glob("bin/fuzz_*"))


def told(output: str) -> str:
    """What a fuzzer says about its run, in one line."""
    runs = re.search(r"number_of_executed_units: +(\d+)", output)
    coverage = re.findall(r"cov: (\d+) ft: (\d+)", output)
    edges, features = coverage[-1] if coverage else ("0", "0")
    return f"{int(runs[1]) if runs else 0:>9} runs, {edges:>5} edges, {features:>6} features"


def why(output: str) -> str:
    """The first thing that a failed fuzzer says about what is wrong."""
    found = REASON.search(output)
    return found[1] if found else "it ended without a reason"


def fuzz(build: Path, target: str, seconds: float) -> tuple[bool, str]:
    """Run one fuzzer; whether all was well, and a line that says so."""
    program = str(build / f"bin/fuzz_{target}")
    seeds, corpus, found = (build / kind / target for kind in ("seeds", "corpus", "found"))
    for folder in (seeds, corpus, found):
        folder.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, **STRICT}
    command = [program, f"-max_len={LONGEST_INPUT}", f"-timeout={LONGEST_RUN_S}", f"-artifact_prefix={found}/"]
    limits = [f"-max_total_time={seconds:g}", "-print_final_stats=1"] if seconds > 0 else ["-runs=0"]
    subprocess.run([program, "--seeds", str(seeds)], check=True, env=environment)
    command += [*limits, str(corpus), str(seeds)]
    done = subprocess.run(command, check=False, capture_output=True, text=True, errors="replace", env=environment)
    if done.returncode == 0:
        return True, f"ok   {target:<16} {told(done.stderr)}"
    kept = max(found.iterdir(), key=lambda file: file.stat().st_mtime, default=found)
    return False, f"FAIL {target:<16} {why(done.stderr)}; again: {program} {kept}"


def main() -> int:
    """Run what was asked for, some at a time; all of them, whatever one finds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help="all, if none is named")
    parser.add_argument("--seconds", type=float, default=2, help="of fuzzing for each, after its seeds (default 2)")
    parser.add_argument("--jobs", type=int, default=min(4, len(os.sched_getaffinity(0))), help="so many at a time")
    args = parser.parse_args()
    known = targets(BUILD)
    unknown = set(args.targets) - set(known)
    if unknown or not known:
        what = f"no such fuzzer: {', '.join(sorted(unknown))}; " if known else "no fuzzer is built; "
        parser.error(what + f"cmake --preset asan && cmake --build --preset asan --target fuzzers; {' '.join(known)}")
    with ThreadPoolExecutor(args.jobs) as pool:
        results = list(pool.map(lambda target: fuzz(BUILD, target, args.seconds), args.targets or known))
    for _, line in results:
        print(line)
    return 0 if all(well for well, _ in results) else 1


if __name__ == "__main__":
    sys.exit(main())
