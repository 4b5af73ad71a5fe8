# SPDX-License-Identifier: Apache-2.0
"""A drive that fails, from its own words to the operator: both kinds, at the far end of real terminals."""

from pathlib import Path
from typing import Any

import pytest
from system.simulated import at_terminals, running


@pytest.mark.parametrize(
    ("device", "joint", "fault", "says"),
    [
        ("wrist_drive", "wrist", "over_temperature", "fault: over-temperature (38)"),
        ("boom_drive", "boom", "over_temperature", "fault: temperature (42xxh)"),
        ("boom_drive", "boom", "encoder", "fault: sensor (73xxh)"),
    ],
)
def test_a_drive_that_fails_is_named_and_comes_back_after_a_reset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, device: str, joint: str, fault: str, says: str
) -> None:
    """The robot stops, status tells whose drive says what, and arm is refused until the fault is over and reset."""
    with at_terminals(tmp_path) as (text, sim), running(text, monkeypatch) as (rig, _):
        assert sim.order(fault=fault, device=device) == {"ok": True}
        rig.wait_for(lambda: rig.ask("status")["mode"] == "safe_stop")

        def told() -> dict[str, Any]:
            return {each["name"]: each for each in rig.ask("status")["joints"]}

        rig.wait_for(lambda: told()[joint]["drive"] == says)  # before that its own ramp stops the joint
        assert (told()[joint]["drive_state"], told()["wrist"]["drive_voltage_v"]) == ("fault", 24.0)
        assert told()["boom"]["drive_temperature_degc"] is None, "the profile of its drive has no object for it"
        assert (rig.ask("status")["fault"], told()[joint]["fault"]) == ("drive_fault", "drive_fault")
        rig.wait_for(lambda: "fault" in told()[joint]["problems"])
        assert all(each["fault"] == "none" for name, each in told().items() if name != joint)
        rig.wait_for(lambda: f"(drive: {says})" in rig.lithe("status").stdout)  # not in a tick without an answer
        assert "drive_fault" in rig.ask("arm", code=3)["error"]["message"]
        rig.ask("reset")  # its cause stays: some drives report it at once, some when they get torque
        again = rig.ask("arm", code=3)["error"]
        assert again["code"] == "refused_fault" and f"joint {joint}" in again["message"], again
        assert f"its drive reports {says}" in again["message"], again
        assert rig.ask("status")["mode"] != "active"
        assert sim.order(fault="clear") == {"ok": True}
        rig.lithe("reset")  # refused when the drive has cleared its fault by itself
        rig.wait_for(lambda: "fault" not in str([each["problems"] for each in rig.ask("status")["joints"]]))
        rig.ask("arm")
        rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
