# SPDX-License-Identifier: Apache-2.0
"""What every system test stands on."""

from collections.abc import Iterator

import pytest
from system.house import House


@pytest.fixture
def house() -> Iterator[House]:
    """A place for one robot."""
    place = House()
    yield place
    place.close()
