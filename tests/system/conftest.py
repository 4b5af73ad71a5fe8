# SPDX-License-Identifier: Apache-2.0
"""What every system test stands on."""

from collections.abc import Iterator

import pytest
from calm import calm_text
from system.house import House


@pytest.fixture
def house() -> Iterator[House]:
    """A place for one robot that does not mind a busy machine; nothing runs yet."""
    with House() as place:
        place.config = place.dir / "arm.toml"
        place.config.write_text(calm_text())
        yield place


@pytest.fixture
def arm(house: House) -> House:
    """The same, armed."""
    house.run()
    house.wait_for(lambda: house.ask("status")["mode"] == "active")
    return house
