# SPDX-License-Identifier: Apache-2.0
"""One line at the end of `make test`, from the JUnit files that its runners wrote: what each counted, in this order,
and the name of every test that was run a second time, with what came of it."""

import sys
from pathlib import Path
from xml.etree import ElementTree

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


def main() -> int:
    """Print the line."""
    files = [Path(name) for name in sys.argv[1:]]
    names = [name for file in files for name in repeated(file)]
    line = " · ".join(filter(None, (counted(file) for file in files)))
    print(f"test: {line}" + (f" · {len(names)} needed a repeat: {', '.join(names)}" if names else ""))
    return 0


if __name__ == "__main__":
    sys.exit(main())
