# SPDX-License-Identifier: Apache-2.0
"""What a test has measured is shown at the end of the run, passed or not."""

from collections.abc import Callable

import pytest
from told import told


@pytest.fixture
def tell(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Keeps a line for the end of the run."""
    return lambda line: request.node.user_properties.append(("measured", f"{request.node.name}: {line}"))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """The lines, below the results."""
    told(terminalreporter, "measured")
