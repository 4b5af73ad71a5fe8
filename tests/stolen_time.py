# SPDX-License-Identifier: Apache-2.0
"""Runs a failed test once more when a hypervisor took the processors away meanwhile, and says so.

On a shared virtual machine stalls of 0.3 s were seen: for so long no robot is controlled, and one that then stops has
done what it should. On a machine of its own no time is stolen, and nothing is run twice here.

No test has more than one repeat. `make test` repeats what failed beside other tests; so nothing is repeated here beside
others, nor in that repeat.
"""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import pytest
from _pytest.runner import runtestprotocol
from told import told

MOST_STOLEN_S = (
    0.05  # of all processors together, since the first test of the file began: its robot may live since then
)
MOST_AGAIN = 2  # of the tests of one file: each time its fixtures are made anew


def repeated_elsewhere(config: pytest.Config) -> bool:
    """Beside other tests, and in the repeat of what failed there."""
    return "PYTEST_XDIST_WORKER" in os.environ or bool(config.getoption("lf", False))


def stolen_s(stat: Path = Path("/proc/stat")) -> float:
    """Time that a hypervisor gave to others so far, of all processors together, as the kernel counts it."""
    return int(stat.read_text(encoding="ascii").split(maxsplit=9)[8]) / os.sysconf("SC_CLK_TCK")


class StolenTime:
    """The plugin."""

    def __init__(self) -> None:
        """Nothing has run yet."""
        self.file: Path | None = None
        self.before_s = 0.0
        self.again: Counter[Path] = Counter()

    def stolen_s(self) -> float:
        """Since the file's first test, or since its fixtures were made anew."""
        return stolen_s() - self.before_s

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool:
        """One test: its setup, itself, its teardown."""
        if item.path != self.file:
            self.file, self.before_s = item.path, stolen_s()
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        reports = runtestprotocol(item, nextitem=nextitem, log=False)
        lost_s = self.stolen_s()
        failed = any(report.failed for report in reports)
        may = not repeated_elsewhere(item.config) and self.again[item.path] < MOST_AGAIN
        if failed and may and lost_s > MOST_STOLEN_S:
            self.again[item.path] += 1
            line = f"{item.nodeid}: failed when {lost_s:.2f} s of the processors' time were stolen"
            item.user_properties.append(("run once more", line))
            item.session._setupstate.teardown_exact(None)  # a robot that fell over is not good for the next test either
            self.before_s = stolen_s()
            reports = runtestprotocol(item, nextitem=nextitem, log=False)
        for report in reports:
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """What ran twice."""
        told(terminalreporter, "run once more")


def pytest_configure(config: pytest.Config) -> None:
    """One for the whole run."""
    config.pluginmanager.register(StolenTime(), "lithe-stolen-time")
