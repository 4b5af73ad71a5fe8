# SPDX-License-Identifier: Apache-2.0
"""What all tests have in common, wherever they lie."""

import os
from collections.abc import Iterator

import pytest

pytest_plugins = ["stolen_time", "inconclusive"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with an early test come first; `--dist loadfile` begins the files in this order."""
    early = {item.path for item in items if item.get_closest_marker("early")}
    items.sort(key=lambda item: item.path not in early)


@pytest.fixture(autouse=True)
def _cores_are_given_back() -> Iterator[None]:
    """A Brain keeps its process on its own cores: the robots of all later tests would have to live there, too."""
    before = os.sched_getaffinity(0)
    yield
    after = os.sched_getaffinity(0)
    os.sched_setaffinity(0, before)
    assert after == before, f"the test left this process on cores {sorted(after)} of {sorted(before)}"
