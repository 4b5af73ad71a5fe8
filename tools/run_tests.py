# SPDX-License-Identifier: Apache-2.0
"""`make test`: every runner, the repeat of what failed beside other tests, and one line at the end.

A test that failed is repeated once, under the same load. More than four of them are an error, with those that
tests/stolen_time.py repeated. So is one of the rooms whose subject is contention: those are never repeated. The last
line has what each runner counted, and the name of every test that was run a second time.
"""

import argparse
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

SAID = Path("build/said")
MOST_REPEATED = 4
NEVER_REPEATED = ("ipc", "law", "loop", "contain", "step", "guard")
CTEST = ["ctest", "--preset", "release"]
EVERY = ["-LE", "^mutant$"]
AGAIN = "-again"  # ends the name of the file of a run that repeats what failed beside other tests
ONCE_MORE = "run once more"  # the property of a test that tests/stolen_time.py repeated


def counted(file: Path) -> str:
    """What one runner counted, by the name of its file; nothing when it did not run."""
    if not file.exists():
        return ""
    root = ElementTree.parse(file).getroot()
    tests, failed, skipped = (
        sum(int(suite.get(word, 0)) for suite in root.iter("testsuite") for word in words)
        for words in (("tests",), ("failures", "errors"), ("skipped", "disabled"))
    )
    proves_nothing = sum(each.get("message", "").startswith("INCONCLUSIVE") for each in root.iter("skipped"))
    line = f"{file.stem} {tests - failed - skipped} passed, {failed} failed, {skipped - proves_nothing} skipped"
    return line + (f", {proves_nothing} inconclusive" if proves_nothing else "")


def outcome(case: ElementTree.Element) -> str:
    """What came of one test."""
    if case.find("failure") is not None or case.find("error") is not None:
        return "failed"
    skipped = case.find("skipped")
    if skipped is None:
        return "passed"
    return "inconclusive" if skipped.get("message", "").startswith("INCONCLUSIVE") else "skipped"


def name_of(case: ElementTree.Element) -> str:
    """The name by which its runner takes a test: ctest gives its tests no class but their name."""
    name, home = case.get("name", ""), case.get("classname", "")
    return name if home == name else f"{home.replace('.', '/')}.py::{name}"


def repeated(file: Path) -> list[str]:
    """The tests of one runner that were run a second time: each says what came of it then."""
    cases = ElementTree.parse(file).getroot().iter("testcase") if file.exists() else []
    return [
        f"{name_of(case)} ({outcome(case)})"
        for case in cases
        if file.stem.endswith(AGAIN) or any(each.get("name") == ONCE_MORE for each in case.iter("property"))
    ]


def failed(file: Path) -> list[ElementTree.Element]:
    """The tests of one runner that failed."""
    cases = ElementTree.parse(file).getroot().iter("testcase") if file.exists() else []
    return [case for case in cases if outcome(case) == "failed"]


def only_these(cases: list[ElementTree.Element]) -> str:
    """C++ tests as ctest takes them."""
    return f"^({'|'.join(re.escape(name_of(case)) for case in cases)})$"


def never_repeated(cpp: list[ElementTree.Element]) -> list[str]:
    """Those of them whose room is never repeated: ctest knows the label of each."""
    listed = subprocess.run(
        [*CTEST, "-N", "-L", f"(^|[.])({'|'.join(NEVER_REPEATED)})$", "-R", only_these(cpp)],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return re.findall(r"Test +#\d+: (\S+)", listed.stdout)


def refused(count: int, never: list[str]) -> str:
    """Why what failed is not repeated; "" when it may be."""
    if never:
        return f"tests of the rooms {', '.join(NEVER_REPEATED)} are never repeated: {', '.join(never)}"
    return f"{count} tests failed; at most {MOST_REPEATED} are repeated" if count > MOST_REPEATED else ""


def repeat(workers: int, python: list[str]) -> bool:
    """Runs what failed once more, beside the C++ tests as the load. Whether all of it passed, or nothing had failed."""
    cpp, other = failed(SAID / "ctest.xml"), failed(SAID / "pytest.xml")
    if why := refused(len(cpp + other), never_repeated(cpp) if cpp else []):
        print(f"make test: {why}", file=sys.stderr)
        return False
    if not cpp + other:
        return True
    load = subprocess.Popen(
        [*CTEST, "-j", str(max(workers - 1, 1)), *EVERY, *(["-E", only_these(cpp)] if cpp else [])],
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        ends = []
        if cpp:
            ends.append(
                run([*CTEST, "-R", only_these(cpp), "--output-junit", str(SAID.absolute() / "ctest-again.xml")])
            )
        if other:
            again = ["--last-failed", "--lfnf=none", f"--junitxml={SAID}/pytest-again.xml"]
            ends.append(run([*python, *again]))
        return not any(ends)
    finally:
        os.killpg(load.pid, signal.SIGTERM)
        load.wait()


def run(command: list[str]) -> int:
    """One runner, seen by who waits. Its exit code."""
    return subprocess.run(command, check=False).returncode


def first_run(name: str, command: list[str]) -> bool:
    """One runner's first run. False when it broke: it ended with an error, and names no test that failed."""
    broke = run(command) != 0 and not failed(SAID / f"{name}.xml")
    if broke:
        print(f"make test: {name} broke; what it printed is above", file=sys.stderr)
    return not broke


def main() -> int:
    """Run all of them; the exit code is 0 when every test passed, some of them at the second time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, default=4, help="tests at a time")
    parser.add_argument("--room", default="", help="only the C++ tests of this room")
    args = parser.parse_args()
    SAID.mkdir(parents=True, exist_ok=True)
    for file in SAID.glob("*.xml"):
        file.unlink()
    only = ["-L", f"(^|[.]){args.room}$"] if args.room else []
    jobs = ["-j", str(args.workers), "--progress"]
    whole = first_run("ctest", [*CTEST, *jobs, "--output-junit", str(SAID.absolute() / "ctest.xml"), *EVERY, *only])
    python = [sys.executable, "-m", "pytest"]
    beside = [*python, "-m", "not alone and not long"]
    if not args.room:
        spread = ["-n", str(args.workers), "--dist", "loadfile", f"--junitxml={SAID}/pytest.xml"]
        whole = first_run("pytest", [*beside, *spread]) and whole
    passed = repeat(args.workers, beside) and whole
    if not args.room:
        passed = run([*python, "-m", "alone and not long", f"--junitxml={SAID}/alone.xml"]) == 0 and passed
    files = [SAID / f"{name}.xml" for name in ("ctest", "ctest-again", "pytest", "pytest-again", "alone")]
    if (count := sum(len(repeated(file)) for file in files)) > MOST_REPEATED:
        print(f"make test: {count} tests were run a second time; at most {MOST_REPEATED} may be", file=sys.stderr)
        passed = False
    print(last_line(files))
    return 0 if passed else 1


def last_line(files: list[Path]) -> str:
    """What each runner counted, and what was run twice."""
    names = [name for file in files for name in repeated(file)]
    line = " · ".join(filter(None, (counted(file) for file in files)))
    return f"test: {line}" + (f" · {len(names)} needed a repeat: {', '.join(names)}" if names else "")


if __name__ == "__main__":
    sys.exit(main())
