# SPDX-License-Identifier: Apache-2.0
"""One line at the end of `make test`: what each runner counted, from the JUnit files that they wrote, in this order."""

import sys
from pathlib import Path
from xml.etree import ElementTree


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


def main() -> int:
    """Print the line."""
    print("test: " + " · ".join(filter(None, (counted(Path(name)) for name in sys.argv[1:]))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
