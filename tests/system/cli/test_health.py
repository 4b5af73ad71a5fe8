# SPDX-License-Identifier: Apache-2.0
"""What comes to the Spine broken is counted, and a user can see it."""

import os

from lithe import _wire
from lithe.shim import shim
from lithe.shm import BrainWriter, SpineView
from system.robot_rig import RobotRig

SOUND = {"plans_torn": 0, "brain_violations": 0, "control_violations": 0, "stage_violations": 0}


def test_a_brain_that_breaks_the_protocol_is_seen_in_the_status(arm: RobotRig) -> None:
    """Nothing is said of a sound robot; then what, whose, and how often. The robot does not mind."""
    os.environ.update({key: value for key, value in arm.env.items() if key.startswith("LITHE_")})
    assert arm.ask("status")["health"] == SOUND
    assert "BROKEN" not in arm.lithe("status").stdout
    brain = BrainWriter("arm")
    spine = SpineView("arm")
    try:
        item, address = brain.mapping.item("commands")
        assert item.kind == "mailbox"
        for broken in (1, 2):  # a head that jumps by more letters than there are slots
            shim().lithe_store(address, shim().lithe_load(address) + 1000)
            arm.wait_for(lambda count=broken: spine.health()["brain_violations"] == count)
        assert spine.health() == arm.ask("status")["health"] == SOUND | {"brain_violations": 2}
        said = [line for line in arm.lithe("status").stdout.splitlines() if "BROKEN" in line]
        assert said == ["  warning BROKEN MESSAGES since the start: broken commands of the Brain: 2"]
        assert arm.ask("status")["mode"] == "active"
    finally:
        brain.close()
    assert set(SOUND) == {name for name, *_ in _wire.DTYPES["Health"]}
