# SPDX-License-Identifier: Apache-2.0
"""What all tests have in common, wherever they lie."""

import gc
import os
import signal
import sys
import warnings
from collections.abc import Callable, Generator, Iterator

import pytest
from told import told

pytest_plugins = ["stolen_time", "inconclusive"]
FAILED = pytest.StashKey[bool]()
# A shell ignores these for what it starts in the background, nohup one of them; every program that a test starts would
# do so, too.
for number, usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(number) == signal.SIG_IGN:
        signal.signal(number, usual)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with an early test come first; `--dist loadfile` begins the files in this order."""
    early = {item.path for item in items if item.get_closest_marker("early")}
    items.sort(key=lambda item: item.path not in early)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Remembers that a test has failed."""
    report = yield
    item.config.stash[FAILED] = item.config.stash.get(FAILED, False) or report.failed
    return report


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """What a failed test did not close fails no other test: it is collected here, and not in the midst of that."""
    if not item.config.stash.get(FAILED, False):
        return
    item.config.stash[FAILED] = False
    for name in ("last_type", "last_value", "last_traceback", "last_exc"):
        vars(sys).pop(name, None)  # they hold the frames of the failed test
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()


@pytest.fixture(autouse=True)
def _cores_are_given_back() -> Iterator[None]:
    """A Brain keeps its process on its own cores: the robots of all later tests would have to live there, too."""
    before = os.sched_getaffinity(0)
    yield
    after = os.sched_getaffinity(0)
    os.sched_setaffinity(0, before)
    assert after == before, f"the test left this process on cores {sorted(after)} of {sorted(before)}"


@pytest.fixture
def tell(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Keeps what a test has measured for the end of the run, passed or not."""
    return lambda line: request.node.user_properties.append(("measured", f"{request.node.name}: {line}"))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """The lines, below the results."""
    told(terminalreporter, "measured")
