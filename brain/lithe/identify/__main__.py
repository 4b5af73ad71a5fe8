# SPDX-License-Identifier: Apache-2.0
"""`python -m lithe.identify ROBOT.toml DATA.npy ... [--json]`: what recorded motion tells of a chain of links.

DATA.npy: telemetry as the flight recorder and `robot.telemetry.history` have it. Each file is a motion of its own.
Exit 0: fitted, also with warnings; 1: the motion tells too little; 2: a file cannot be read.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import LitheError
from .chain import ChainFit, describe, identify_chain
from .joint import Motion


def motion_of(records: npt.NDArray[Any], joints: int) -> list[Motion]:
    """Telemetry as one Motion per joint. LitheError where it has other fields or fewer joints."""
    try:
        t_s = 1e-9 * (records["sample_ns"] - records["sample_ns"][0]).astype(np.float64)
        columns = [
            np.asarray(records[name], dtype=np.float64) for name in ("position_rad", "velocity_rad_s", "torque_nm")
        ]
        if any(column.shape[1] < joints for column in columns):
            raise ValueError(f"it has {columns[0].shape[1]} joints, the robot {joints}")
    except (ValueError, IndexError, TypeError) as error:
        raise LitheError(
            f"this is no telemetry of the robot: {error}\n  next: give .npy files of the flight recorder"
        ) from None
    return [Motion(t_s, *(column[:, j] for column in columns)) for j in range(joints)]


def table(fit: ChainFit) -> str:
    """The estimates, one a line, and what the motion left."""
    lines = [f"{'joint':<12} {'parameter':<12} {'value':>12}  95 % interval"]
    for each in fit.parameters:
        lines.append(
            f"{each.joint:<12} {each.name:<12} {each.value:12.5g}  {each.low:.5g} to {each.high:.5g} {each.unit}"
        )
    left = ", ".join(f"{name} {value:.4f} N m" for name, value in fit.residual_nm.items())
    lines.append(f"{fit.windows} windows, condition number {fit.condition:.0f}, left unexplained: {left}")
    return "\n".join([*lines, *(f"warning: {warning}" for warning in fit.warnings)])


def main(words: list[str]) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="python -m lithe.identify", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("robot", type=Path, help='a robot file with [plant] kind = "chain"')
    parser.add_argument("data", type=Path, nargs="+", help="telemetry, .npy")
    parser.add_argument("--json", action="store_true", help="print JSON")
    asked = parser.parse_args(words)
    try:
        chain = describe(asked.robot)
        motions = []
        for path in asked.data:
            try:
                motions.append(motion_of(np.load(path, allow_pickle=False), len(chain.names)))
            except (OSError, ValueError) as error:
                raise LitheError(
                    f"cannot read {path}: {error}\n  next: give .npy files of the flight recorder"
                ) from None
            except LitheError as error:
                raise LitheError(f"{path}: {error}") from None
        fit = identify_chain(chain, motions)
    except LitheError as error:
        print(f"lithe.identify: {error}", file=sys.stderr)
        return 2
    except ValueError as error:
        print(f"lithe.identify: {error}", file=sys.stderr)
        return 1
    if asked.json:
        print(json.dumps({**asdict(fit), "parameters": [asdict(each) for each in fit.parameters]}))
    else:
        print(table(fit))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
