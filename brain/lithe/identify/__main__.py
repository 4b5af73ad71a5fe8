# SPDX-License-Identifier: Apache-2.0
"""`python -m lithe.identify ROBOT.toml DATA.npy ... [--model FILE | --write OUT.toml] [--json]`: what motion tells of a
robot.

DATA.npy: telemetry as the flight recorder and `robot.telemetry.history` have it. Each file is a motion of its own.
OUT.toml: the robot file with a simulated plant as it was recorded, for `lithe.evolve`; never one that is there already.
Exit 0: fitted, also with warnings; 1: the motion tells too little; 2: a file cannot be read or written.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import asdict
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import LitheError
from ..files import read_regular
from .chain import ChainFit, describe, identify_chain
from .joint import Arm, Motion, identify_joint
from .model import describe_model
from .plant import Plant, Values, chain_values, joint_values, plant_of, with_values, write_new

NPY = b"\x93NUMPY"  # how each such file begins


def motion_of(records: npt.NDArray[Any], joints: int) -> list[Motion]:
    """Telemetry as one Motion per joint. LitheError where it has other fields or another number of joints."""
    try:
        if records.dtype.names is None:
            raise ValueError("it has numbers without names")
        if len(records) == 0:
            raise ValueError("it is empty")
        t_s = 1e-9 * (records["sample_ns"] - records["sample_ns"][0]).astype(np.float64)
        columns = [
            np.asarray(records[name], dtype=np.float64) for name in ("position_rad", "velocity_rad_s", "torque_nm")
        ]
        recorded = int(records["joint_count"][0]) if "joint_count" in records.dtype.names else joints
        if recorded != joints or any(column.shape[1] < joints for column in columns):
            raise ValueError(f"it has {min(recorded, columns[0].shape[1])} joints, the robot {joints}")
    except (ValueError, IndexError, TypeError) as error:
        raise LitheError(
            f"this is no telemetry of the robot: {error}\n  next: give .npy files of the flight recorder"
        ) from None
    return [Motion(t_s, *(column[:, j] for column in columns)) for j in range(joints)]


def table(fit: ChainFit, file_values: tuple[float, ...] = ()) -> str:
    """The estimates, one a line, and what the motion left. `file_values`: of the first ones, in a model file."""
    lines = [f"{'joint':<12} {'parameter':<12} {'value':>12}  95 % interval"]
    for each, of_file in zip_longest(fit.parameters, file_values):
        lines.append(
            f"{each.joint:<12} {each.name:<12} {each.value:12.5g}  {each.low:.5g} to {each.high:.5g} {each.unit}"
            + (f" (file: {of_file:.5g})" if of_file is not None else "")
        )
    left = ", ".join(f"{name} {value:.4f} N m" for name, value in fit.residual_nm.items())
    if fit.given:
        lines.append("given, not found: " + ", ".join(f"{name} {value:g}" for name, value in fit.given.items()))
    lines.append(f"{fit.windows} windows, condition number {fit.condition:.0f}, left unexplained: {left}")
    return "\n".join([*lines, *(f"warning: {warning}" for warning in fit.warnings)])


def arm_table(arms: dict[str, Arm]) -> str:
    """Of joints that swing each on its own."""
    lines = [f"{'joint':<12} {'inertia kg m2':>14} {'mgl N m':>10} {'viscous':>10} {'coulomb N m':>12}"]
    for name, arm in arms.items():
        lines.append(f"{name:<12} {arm.inertia_kg_m2:14.4g} {arm.mgl_nm:10.4g} {arm.viscous_nm_s_rad:10.3g} "
                     f"{arm.coulomb_nm:12.4g}")  # fmt: skip
    return "\n".join(lines)


def motions_of(paths: list[Path], joints: int) -> list[list[Motion]]:
    """Of each file a Motion per joint. LitheError names the file."""
    motions = []
    for path in paths:
        try:
            with path.open("rb") as file:
                if file.read(len(NPY)) != NPY:
                    raise ValueError("it is no .npy file")
            motions.append(motion_of(np.load(path, allow_pickle=False), joints))
        except (OSError, ValueError) as error:
            why = error.strerror if isinstance(error, OSError) else error
            raise LitheError(f"cannot read {path}: {why}\n  next: give .npy files of the flight recorder") from None
        except LitheError as error:
            raise LitheError(f"{path}: {error}") from None
    return motions


def identify(robot: Path, plant: Plant, data: list[Path], file: Path | None) -> tuple[Values, str, dict[str, Any]]:
    """What the motion tells: values of the plant (of a model file none), a table, and the same for JSON.

    LitheError: without a model file the plant must be a chain or independent joints.
    """
    if file is not None:
        model = describe_model(file, tuple(plant.sims))
        fit = identify_chain(model, motions_of(data, len(plant.sims)), look_further=True)
        return {}, table(fit, model.file_values), {**asdict(fit), "file_values": model.file_values}
    if plant.kind == "chain":
        fit = identify_chain(describe(robot), motions_of(data, len(plant.sims)), look_further=True)
        return chain_values(plant, fit), table(fit), asdict(fit)
    if plant.kind != "independent":
        raise LitheError(
            f'a plant of kind "{plant.kind}" has its parameters in its model file\n'
            "  next: python -m lithe.identify --model FILE; change the file by what is printed"
        )
    motions = motions_of(data, len(plant.sims))
    arms: dict[str, Arm] = {}
    for name, those in zip(plant.sims, zip(*motions, strict=True), strict=True):
        try:
            arms[name] = identify_joint(list(those))
        except (ValueError, np.linalg.LinAlgError) as error:
            raise ValueError(f"joint '{name}': {error}") from None
    return joint_values(plant, arms), arm_table(arms), {"joints": {name: asdict(arm) for name, arm in arms.items()}}


def run(asked: argparse.Namespace) -> None:
    """As asked. LitheError: bad input; ValueError: the motion tells too little."""
    try:
        text = read_regular(asked.robot)
        plant = plant_of(text)
    except (OSError, ValueError) as error:
        raise LitheError(f"cannot read {asked.robot}: {error}\n  next: give a robot file") from None
    except LitheError as error:
        raise LitheError(f"{asked.robot}: {error}\n  next: `lithe bus plan` names its mistakes") from None
    if asked.write is not None and os.path.lexists(asked.write):
        raise LitheError(f"{asked.write} is there already, and stays as it is\n  next: --write with another name")
    file = asked.model or (asked.robot.parent / plant.model if plant.model else None)
    if asked.write is not None and file is not None:
        raise LitheError(f"{file} has the links' parameters\n  next: no --write; change the file by what is printed")
    values, said, told = identify(asked.robot, plant, asked.data, file)
    if asked.write is not None:
        write_new(asked.write, with_values(text, values))
    print(json.dumps(told) if asked.json else said)
    if asked.write is not None and asked.write.resolve().parent != asked.robot.resolve().parent:
        print("note: paths in a robot file, such as its law's, are relative to its folder", file=sys.stderr)


def main(words: list[str]) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="python -m lithe.identify", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("robot", type=Path, help="a robot file")
    parser.add_argument("data", type=Path, nargs="+", help="telemetry, .npy")
    parser.add_argument(
        "--model",
        type=Path,
        metavar="FILE",
        help="its links, URDF or MJCF; needs pin (default: that of a MuJoCo plant)",
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--write", type=Path, metavar="OUT.toml", help="the robot file with the plant that was found")
    try:
        run(parser.parse_args(words))
    except LitheError as error:
        print(f"lithe.identify: {error}", file=sys.stderr)
        return 2
    except ValueError as error:
        print(f"lithe.identify: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
