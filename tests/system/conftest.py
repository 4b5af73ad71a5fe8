# SPDX-License-Identifier: Apache-2.0
"""What every system test stands on."""

from collections.abc import Iterator

import pytest
from calm import calm_text
from system.house import House


@pytest.fixture
def house() -> Iterator[House]:
    """A place for one robot."""
    place = House()
    yield place
    place.close()


@pytest.fixture
def patient() -> Iterator[House]:
    """A house whose robot does not mind a busy machine; nothing runs yet."""
    house = House()
    house.config = house.dir / "arm.toml"
    house.config.write_text(calm_text())
    yield house
    house.close()


@pytest.fixture
def arm(patient: House) -> House:
    """The same, armed."""
    patient.run()
    patient.wait_for(lambda: patient.ask("status")["mode"] == "active")
    return patient
