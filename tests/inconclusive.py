# SPDX-License-Identifier: Apache-2.0
"""A run that proves nothing is neither passed nor skipped: pytest's last line counts it by a word of its own.

`inconclusive()` ends a test in which the kernel's counts say that the machine took the core away. Beside other tests it
is a failure, so that `make test` repeats it with nothing beside it; there it ends as inconclusive, and is named.
"""

from __future__ import annotations

import os
from typing import NoReturn

import pytest

WORD = "INCONCLUSIVE"


def inconclusive(why: str) -> NoReturn:
    """Ends the test that calls it."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        pytest.fail(f"{WORD} beside other tests: {why}. It counts when it runs by itself", pytrace=False)
    pytest.skip(f"{WORD}: {why}")


def is_inconclusive(report: pytest.CollectReport | pytest.TestReport) -> bool:
    """A test that inconclusive() ended; it was by itself."""
    if not report.skipped or not isinstance(report.longrepr, tuple):
        return False
    return f"{WORD}: " in report.longrepr[2]


def pytest_report_teststatus(
    report: pytest.CollectReport | pytest.TestReport,
) -> tuple[str, str, str] | None:
    """Its category in the last line, its letter, its word."""
    return ("inconclusive", "i", WORD) if is_inconclusive(report) else None


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Which they were, and why."""
    found = terminalreporter.stats.get("inconclusive", [])
    if found:
        terminalreporter.section("inconclusive")
        terminalreporter.write_line(f"inconclusive: {len(found)} ({', '.join(each.nodeid for each in found)})")
        for each in found:
            terminalreporter.write_line(f"{each.nodeid}: {each.longrepr[2].removeprefix('Skipped: ')}")
