# SPDX-License-Identifier: Apache-2.0
"""A robot file whose simulated plant is as it was recorded: the same text with other values of [joint.sim].

Only values that were found are changed or added; every other line stays as it is, with its comments.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import LitheError
from ..files import robot_table
from .chain import ChainFit, Parameter
from .joint import INTERVAL_SE, Arm, Vector

MORE = 1.05  # times the least mass that a link can have
LEAST_SHARE = 0.05  # of its mass in the file
ENTRY = re.compile(r"(?P<key>[A-Za-z0-9_]+)(?P<equals>\s*=\s*)(?P<value>[-+0-9._eE]+)(?P<rest>[ \t]*(#.*)?)$")


@dataclass(frozen=True)
class Value:
    """Of one key of [joint.sim]; `says`: what is known of it, for a comment."""

    value: float
    says: str = ""


Values = dict[str, dict[str, Value]]  # of each joint, by key


@dataclass(frozen=True)
class Plant:
    """What a robot file says of its simulated joints: `kind` of the plant, of each joint the keys of its sim, and where
    the kind is "mujoco", the file of the `model`.
    """

    kind: str
    sims: dict[str, dict[str, Any]]
    model: str = ""


def plant_of(text: str) -> Plant:
    """That of a robot file's text. LitheError where it is none."""
    try:
        config = robot_table(text)
        sims = {str(joint["name"]): joint["sim"] for joint in config["joint"]}
        plant = config.get("plant", {})
        return Plant(str(plant.get("kind", "independent")), sims, str(plant.get("model", "")))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise LitheError(f"this is no robot file: {type(error).__name__}: {error}") from None


def joint_values(plant: Plant, arms: Mapping[str, Arm]) -> Values:
    """Of joints that swing each on its own. A payload that the file has is in them, and so has none of its own."""
    found: Values = {}
    for name, arm in arms.items():
        least, most = arm.mgl_interval_nm
        half = INTERVAL_SE * arm.inertia_se_kg_m2, INTERVAL_SE * arm.coulomb_se_nm
        found[name] = {
            "inertia_kg_m2": _about(arm.inertia_kg_m2, half[0]),
            "mgl_nm": Value(max(arm.mgl_nm, 0.0), f"{least:.4g} to {most:.4g}"),
            "viscous_nm_s_rad": Value(max(arm.viscous_nm_s_rad, 0.0)),
            "coulomb_nm": _about(max(arm.coulomb_nm, 0.0), half[1]),
            **_without_payload(plant.sims[name]),
        }
    return found


def _about(value: float, half: float) -> Value:
    return Value(value, f"{max(value - half, 0.0):.4g} to {value + half:.4g}")


def _without_payload(sim: dict[str, Any]) -> dict[str, Value]:
    return {"payload_kg": Value(0.0, "it is in the other values")} if sim.get("payload_kg") else {}


def chain_values(plant: Plant, fit: ChainFit) -> Values:
    """Of a chain. Its motion tells no masses, but sums of them (regressor.py); of all links that have these sums, those
    are taken that are like the file's: its first mass, and its centres but for the last, where that is possible.

    LitheError: no links have these sums.
    """
    names = list(plant.sims)
    friction = {"viscous": "viscous_nm_s_rad", "coulomb": "coulomb_nm", "stribeck": "stribeck_nm", "rotor":
                "rotor_inertia_kg_m2"}  # fmt: skip
    found: Values = {name: {} for name in names}
    known = {(each.joint, each.name): each for each in fit.parameters}
    for (joint, name), each in known.items():
        if name in friction:
            found[joint][friction[name]] = Value(max(each.value, 0.0), _interval(each))
        elif name == "cogging_cos":
            found[joint]["cogging_nm"] = Value(float(np.hypot(each.value, known[joint, "cogging_sin"].value)))
    mass, centre, inertia = _links(plant, [known[name, "moment"] for name in names],
                                   [known[name, "inertia"] for name in names])  # fmt: skip
    for k, name in enumerate(names):
        moment, about = known[name, "moment"], known[name, "inertia"]
        found[name] |= {
            "mass_kg": Value(float(mass[k])),
            "center_m": Value(float(centre[k]), f"moment {_interval(moment)} {moment.unit}"),
            "link_inertia_kg_m2": Value(float(inertia[k]), f"about the joint {_interval(about)} {about.unit}"),
            **_without_payload(plant.sims[name]),
        }
    return found


def _interval(each: Parameter) -> str:
    return f"{each.low:.4g} to {each.high:.4g}"


def _links(plant: Plant, moments: list[Parameter], inertias: list[Parameter]) -> tuple[Vector, Vector, Vector]:
    """Mass, centre and inertia about the centre of links with these moments and inertias."""
    sims = list(plant.sims.values())
    length = np.array([float(sim["length_m"]) for sim in sims])
    mass = np.array([float(sim["mass_kg"]) for sim in sims])
    centre = np.array([float(sim.get("center_m", sim["length_m"] / 2)) for sim in sims])
    moment, about = np.array([each.value for each in moments]), np.array([each.value for each in inertias])
    about[0] -= float(sims[0].get("rotor_inertia_kg_m2", 0.0))
    for masses_of in (_like_the_file, _lightest):
        masses = masses_of(length, mass, centre, moment, about)
        beyond = np.append(np.cumsum(masses[::-1])[::-1][1:], 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            centres = (moment - length * beyond) / masses
            own = about - length**2 * beyond - masses * centres**2
        if np.all(np.isfinite(centres)) and np.all(masses > 0) and np.all(own >= 0):
            return masses, centres, own
    raise LitheError(
        f"no links have the moments {np.round(moment, 5)} kg m and the inertias {np.round(about, 6)} kg m2 that were "
        "found\n  next: record a motion that tells more (lithe.identify.design_multisine)"
    )


def _like_the_file(length: Vector, mass: Vector, centre: Vector, moment: Vector, about: Vector) -> Vector:
    """Masses, some perhaps negative, that give these moments with the first mass and these centres but the last."""
    masses, beyond = np.zeros(len(length)), mass[0]
    for k in range(len(length)):
        if k == len(length) - 1 or centre[k] == length[k]:
            masses[k] = beyond
        else:
            masses[k] = mass[0] if k == 0 else (moment[k] - length[k] * beyond) / (centre[k] - length[k])
        beyond = (moment[0] - mass[0] * centre[0]) / length[0] if k == 0 else beyond - masses[k]
    return masses


def _lightest(length: Vector, mass: Vector, centre: Vector, moment: Vector, about: Vector) -> Vector:
    """From the end inwards: of each link hardly more than it must have, so that the inner ones can be."""
    masses, beyond = np.zeros(len(length)), 0.0
    for k in reversed(range(len(length))):
        left = max(about[k] - length[k] ** 2 * beyond, 1e-12)
        masses[k] = max(MORE * (moment[k] - length[k] * beyond) ** 2 / left, LEAST_SHARE * mass[k])
        beyond += masses[k]
    return masses


def with_values(text: str, values: Values) -> str:
    """The text of a robot file with these values. LitheError where it says them in a form that cannot be changed."""
    lines = text.splitlines()
    before = tomllib.loads(text)
    for number, joint in reversed(list(enumerate(before["joint"]))):
        _change(lines, number, dict(values[str(joint["name"])]))
    changed = "\n".join(lines) + "\n"
    for joint in before["joint"]:
        sim = {key: each.value for key, each in values[str(joint["name"])].items()}
        joint["sim"] = {**joint.get("sim", {}), **{key: float(_number(value)) for key, value in sim.items()}}
    try:
        as_meant = tomllib.loads(changed) == before
    except tomllib.TOMLDecodeError:
        as_meant = False
    if not as_meant:
        raise LitheError(
            "this robot file says its joints in a form that cannot be changed here\n"
            "  next: give each [[joint]] a table [joint.sim] of its own, with one key on a line"
        )
    return changed


def _change(lines: list[str], number: int, sim: dict[str, Value]) -> None:
    """In place: the sim of the joint of that number."""
    heads = [k for k, line in enumerate(lines) if line.strip().startswith("[")]
    starts = [k for k in heads if re.match(r"\s*\[\[\s*joint\s*\]\]", lines[k])]
    if number >= len(starts):
        return  # with_values() says so
    ends = [*(k for k in heads if k > starts[number]), len(lines)]
    own = [k for k in ends[:-1] if re.match(r"\s*\[\s*joint\s*\.\s*sim\s*\]", lines[k])]
    if not own or (number + 1 < len(starts) and own[0] > starts[number + 1]):
        at = _last_entry(lines, starts[number], ends[0])
        lines.insert(at + 1, "[joint.sim]")
        first = last = at + 2
    else:
        first, last = own[0] + 1, next(k for k in ends if k > own[0])
    for k in range(first, last):
        entry = ENTRY.match(lines[k].strip())
        if entry and (each := sim.pop(entry["key"], None)):
            comment = entry["rest"].strip()
            said = _comment(each).replace("  # ", "; ") if comment else _comment(each)
            lines[k] = f"{entry['key']}{entry['equals']}{_number(each.value)}{entry['rest'] if comment else ''}{said}"
    at = _last_entry(lines, first - 1, last) + 1
    lines[at:at] = [f"{key} = {_number(each.value)}{_comment(each)}" for key, each in sim.items()]


def _number(value: float) -> str:
    """As a TOML float: 0.0, not 0."""
    text = f"{value:.6g}"
    return text if "." in text or "e" in text else f"{text}.0"


def _comment(each: Value) -> str:
    return f"  # identified: {each.says}" if each.says else "  # identified"


def _last_entry(lines: list[str], head: int, end: int) -> int:
    """The last line of a table that is no comment and not empty."""
    return max(k for k in range(head, end) if k == head or (lines[k].strip() and not lines[k].strip().startswith("#")))


def write_new(path: Path, text: str) -> None:
    """A file that was not there. LitheError where it was, or cannot be written."""
    try:
        file = os.fdopen(
            os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644), "w", encoding="utf-8"
        )
        with file:
            file.write(text)
    except FileExistsError:
        raise LitheError(f"{path} is there already, and stays as it is\n  next: --write with another name") from None
    except OSError as error:
        raise LitheError(
            f"cannot write {path}: {error.strerror}\n  next: --write FILE in a folder that is there"
        ) from None
