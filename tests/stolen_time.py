# SPDX-License-Identifier: Apache-2.0
"""Runs a failed test once more when a hypervisor took the processors away meanwhile, and says so.

On a shared virtual machine stalls of 0.3 s were seen: for so long no robot is controlled, and one that then stops has
done what it should. On a machine of its own no time is stolen, and nothing is ever run twice.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest
from _pytest.runner import runtestprotocol

MOST_STOLEN = 0.01  # of all processors' time, since the first test of the file began
MOST_AGAIN = 2  # of the tests of one file: each time its fixtures are made anew


@dataclass(frozen=True)
class Processors:
    """How the time of all processors was spent so far [ticks of /proc/stat]."""

    stolen: int
    all: int

    @classmethod
    def now(cls, stat: Path = Path("/proc/stat")) -> Processors:
        """As the kernel counts it."""
        spent = [int(word) for word in stat.read_text(encoding="ascii").split("\n", 1)[0].split()[1:9]]
        return cls(spent[7], sum(spent))

    def stolen_since(self, before: Processors) -> float:
        """Share of the time between the two."""
        return (self.stolen - before.stolen) / max(self.all - before.all, 1)


class StolenTime:
    """The plugin."""

    def __init__(self) -> None:
        """Nothing has run yet."""
        self.file: Path | None = None
        self.before = Processors(0, 0)
        self.again: Counter[Path] = Counter()
        self.told: list[str] = []

    def stolen(self) -> float:
        """Of the time since the file's first test, or since its fixtures were made anew."""
        return Processors.now().stolen_since(self.before)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool:
        """One test: its setup, itself, its teardown."""
        if item.path != self.file:
            self.file, self.before = item.path, Processors.now()
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        reports = runtestprotocol(item, nextitem=nextitem, log=False)
        stolen = self.stolen()
        failed = any(report.failed for report in reports)
        if failed and stolen > MOST_STOLEN and self.again[item.path] < MOST_AGAIN:
            self.again[item.path] += 1
            self.told.append(f"{item.nodeid}: failed while {100 * stolen:.1f} % of the processors' time was stolen")
            item.session._setupstate.teardown_exact(None)  # a robot that fell over is not good for the next test either
            self.before = Processors.now()
            reports = runtestprotocol(item, nextitem=nextitem, log=False)
        for report in reports:
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """What ran twice."""
        if self.told:
            terminalreporter.section("run once more")
            for line in self.told:
                terminalreporter.write_line(line)


def pytest_configure(config: pytest.Config) -> None:
    """One for the whole run."""
    config.pluginmanager.register(StolenTime(), "lithe-stolen-time")
