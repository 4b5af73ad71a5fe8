# SPDX-License-Identifier: Apache-2.0
"""Runs the tests of tests/cases/table.toml, a line each; with --twins, shows that they can fail.

python tests/cases/run.py [WORDS]        those whose text or kind holds WORDS; all without
python tests/cases/run.py --twins        makes one line of the product wrong again, builds, runs the case, puts it back
"""

import argparse
import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
Case = dict[str, Any]


def table() -> list[Case]:
    cases: list[Case] = tomllib.loads(Path(__file__).with_name("table.toml").read_text())["case"]
    return cases


def output(*command: str) -> tuple[bool, str]:
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    return done.returncode == 0, done.stdout + done.stderr


def programs(names: list[str]) -> dict[str, str]:
    """The program of each C++ test, as ctest knows it."""
    _, told = output("ctest", "--preset", "release", "--show-only=json-v1")
    tests = [test for test in json.loads(told)["tests"] if test.get("command")]
    known = {re.sub(r"^[^/.]+/|/.*$", "", test["name"]): test["command"][0] for test in tests}
    if missing := [name for name in names if name not in known]:
        sys.exit(
            f"not built, or of no such name: {', '.join(missing)}\nnext: make test, or correct tests/cases/table.toml"
        )
    return {name: known[name] for name in names}


def failed(case: Case) -> str:
    """What the first of its tests that does not pass says; "" when all pass."""
    cpp = [name for name in case["tests"] if ".py" not in name]
    for name, program in programs(cpp).items():
        passed, told = output(program, f"--gtest_filter={name}:*/{name}/*")
        if not passed or "[  PASSED  ] 0" in told:
            return f"{name}\n{told[-2000:]}"
    python = [name for name in case["tests"] if ".py" in name]
    passed, told = output(sys.executable, "-m", "pytest", "-q", "-x", *python) if python else (True, "")
    return "" if passed else told[-2000:]


@contextmanager
def wrong_again(twin: dict[str, str]) -> Iterator[None]:
    """The line of the product is the twin's until the end of `with`."""
    file = ROOT / twin["file"]
    text = file.read_text()
    if text.count(twin["was"]) != 1:
        sys.exit(f"{twin['file']} has {text.count(twin['was'])} times: {twin['was']}\nnext: correct the twin")
    try:
        file.write_text(text.replace(twin["was"], twin["becomes"]))
        yield
    finally:
        file.write_text(text)


def build(case: Case) -> None:
    cpp = [name for name in case["tests"] if ".py" not in name]
    targets = {Path(program).name for program in programs(cpp).values()}
    if len(cpp) < len(case["tests"]):
        targets |= {"lithe", "lithe-spine", "lithe-spine-sim", "lawd", "lithe-trial", "lithe-sim"}
    built, told = output("cmake", "--build", "--preset", "release", "--target", *sorted(targets))
    if not built:
        sys.exit(told[-4000:])


def refuted(case: Case) -> bool:
    """The twin is built, and a test of the case fails."""
    with wrong_again(case["twin"]):
        build(case)
        says = failed(case)
    build(case)
    print(f"{'refuted ' if says else 'NOT SEEN'} {case['kind']}: {case['says']}", flush=True)
    return says != ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="?", default="")
    parser.add_argument("--twins", action="store_true")
    args = parser.parse_args()
    chosen = [case for case in table() if args.words in case["says"] + case["kind"]]
    if args.twins:
        seen = [refuted(case) for case in chosen if "twin" in case]
        return 0 if seen and all(seen) else 1
    bad = 0
    for case in chosen:
        says = failed(case)
        print(f"{'FAILED' if says else 'ok    '} {case['kind']}: {case['says']}", flush=True)
        print(says, end="")
        bad += says != ""
    print(f"cases: {len(chosen) - bad} passed, {bad} failed")
    return 1 if bad or not chosen else 0


if __name__ == "__main__":
    sys.exit(main())
