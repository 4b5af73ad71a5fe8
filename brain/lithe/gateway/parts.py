# SPDX-License-Identifier: Apache-2.0
"""What the robot file says of drives and sensors, for agents that have nothing but the gateway."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from ..files import read_regular


def parts_of(robot_file: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Of each joint its `device`, that one's `kind` and `bus`; of each sensor `kind` and `device`.

    Both are empty when the file is no longer there, or another one than the robot was started with.
    """
    try:
        config = tomllib.loads(read_regular(robot_file))
        usual = config.get("defaults", {}).get("device", {})
        devices = {own["name"]: {**usual, **own} for own in config.get("device", [])}
        drives = {}
        for joint in config["joint"]:
            device = devices.get(joint.get("device"), {})
            drives[joint["name"]] = {key: device.get(name) for key, name in
                                     (("device", "name"), ("kind", "kind"), ("bus", "bus"))}  # fmt: skip
        sensors = {one["name"]: {key: one.get(key) for key in ("kind", "device")} for one in config.get("sensor", [])}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}, {}
    return drives, sensors
