# SPDX-License-Identifier: Apache-2.0
"""What every system test stands on."""

from collections.abc import Iterator

import pytest
from calm import calm_text
from system.robot_rig import RobotRig


@pytest.fixture
def rig() -> Iterator[RobotRig]:
    """A place for one robot that does not mind a busy machine; nothing runs yet."""
    with RobotRig() as place:
        place.config = place.dir / "arm.toml"
        place.config.write_text(calm_text())
        yield place


@pytest.fixture
def arm(rig: RobotRig) -> RobotRig:
    """The same, armed."""
    rig.run()
    rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
    return rig
