# SPDX-License-Identifier: Apache-2.0
"""What a test has measured is shown at the end of the run, passed or not."""

from collections.abc import Callable

import pytest

_TOLD = pytest.StashKey[list[str]]()


@pytest.fixture
def tell(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Keeps a line for the end of the run."""
    lines = request.config.stash.setdefault(_TOLD, [])
    return lambda line: lines.append(f"{request.node.name}: {line}")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """The lines, below the results."""
    if lines := config.stash.get(_TOLD, []):
        terminalreporter.section("measured")
        for line in lines:
            terminalreporter.write_line(line)
