# SPDX-License-Identifier: Apache-2.0
"""What every system test stands on."""

from collections.abc import Iterator

import pytest
from system.house import BIN, House


@pytest.fixture
def house() -> Iterator[House]:
    """A place for one robot."""
    if not (BIN / "lithe-spine").exists():
        pytest.skip(f"no binaries in {BIN}: make, or set LITHE_BIN_DIR")
    place = House()
    yield place
    place.close()
