# SPDX-License-Identifier: Apache-2.0
"""Lines that tests leave for the end of the run.

They travel with a test's report, so that they also arrive from a process of pytest-xdist.
"""

from __future__ import annotations

import pytest


def told(reporter: pytest.TerminalReporter, section: str) -> None:
    """Write the lines that the tests left for this section; no line, no section."""
    ends = [each for reports in reporter.stats.values() for each in reports if getattr(each, "when", "") == "teardown"]
    lines = [line for report in ends for name, line in report.user_properties if name == section]
    if lines:
        reporter.section(section)
        for line in lines:
            reporter.write_line(line)
