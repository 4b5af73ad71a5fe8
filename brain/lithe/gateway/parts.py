# SPDX-License-Identifier: Apache-2.0
"""What the robot file says of drives, sensors and the simulation, for agents that have nothing but the gateway."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..errors import LitheError
from ..files import read_regular, robot_table
from ..identify.chain import describe

Table = dict[str, Any]
WRONG = (OSError, ValueError, KeyError, TypeError, AttributeError)  # the file is gone, or another one by now
DEFAULTS = "document plants: what each key means, and its value where it is not given here"


def _devices(config: Table) -> Table:
    return {device["name"]: device for device in config.get("device", [])}


def parts_of(robot_file: Path) -> tuple[Table, Table]:
    """Of each joint its `device`, that one's `kind` and `bus`; of each sensor `kind` and `device`.

    Both are empty when the file is no longer there, or another one than the robot was started with.
    """
    try:
        config = robot_table(read_regular(robot_file))
        devices = _devices(config)
        drives = {}
        for joint in config["joint"]:
            device = devices.get(joint.get("device"), {})
            drives[joint["name"]] = {key: device.get(name) for key, name in
                                     (("device", "name"), ("kind", "kind"), ("bus", "bus"))}  # fmt: skip
        sensors = {one["name"]: {key: one.get(key) for key in ("kind", "device")} for one in config.get("sensor", [])}
    except WRONG:
        return {}, {}
    return drives, sensors


def simulation_of(robot_file: Path) -> Table | None:
    """What the file states of simulated joints, word by word: `plant`, `buses`, and the keys of each joint's sim.

    None: no bus is simulated by the Spine, or the file is gone.
    """
    try:
        config = robot_table(read_regular(robot_file))
        buses = {bus["name"]: bus for bus in config["bus"] if bus["kind"] == "loop"}
        devices = _devices(config)
        joints = {joint["name"]: joint["sim"] for joint in config["joint"] if devices[joint["device"]]["bus"] in buses}
        rates = {name: {key: bus[key] for key in ("bitrate", "data_bitrate") if key in bus}
                 for name, bus in buses.items()}  # fmt: skip
        plant = {"kind": "independent", **config.get("plant", {})}
    except WRONG:
        return None
    told: Table = {"source": "simulated", "plant": plant, "buses": rates, "joints": joints, "defaults": DEFAULTS}
    if plant["kind"] == "chain" and len(joints) == len(config["joint"]):
        told["effective"] = _effective(joints)
    return told if joints else None


def _effective(joints: Table) -> Table | None:
    """Of each link of a chain the constants C, mu and R of the document chain; defaults as in plants.md."""
    found, outwards_kg = {}, 0.0
    try:
        for name, sim in reversed(joints.items()):
            length_m, mass_kg = float(sim["length_m"]), float(sim["mass_kg"])
            centre_m = float(sim.get("center_m", length_m / 2))
            inertia = float(sim.get("link_inertia_kg_m2", mass_kg * length_m**2 / 12))
            found[name] = {
                "C_kg_m2": inertia + mass_kg * centre_m**2 + length_m**2 * outwards_kg,
                "mu_kg_m": mass_kg * centre_m + length_m * outwards_kg,
                "R_kg_m2": float(sim.get("rotor_inertia_kg_m2", 0.0)),
            }
            outwards_kg += mass_kg
    except WRONG:
        return None
    return {name: {key: round(value, 9) for key, value in found[name].items()} for name in joints}


def chain_of(robot_file: Path) -> Table | None:
    """Names, lengths and gravity, as lithe.identify takes them; None: no chain of links, or the file is gone.

    Nothing that a person with a tape measure would not know: friction and cogging are for the motion to tell.
    """
    try:
        told = asdict(describe(robot_file))
        return {key: told[key] for key in ("names", "length_m", "gravity_m_s2")}
    except LitheError:
        return None
