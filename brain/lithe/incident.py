# SPDX-License-Identifier: Apache-2.0
"""What the flight recorder kept around a fault, a rollback or a change of mode.

`python -m lithe.incident FILE.npy [--out PICTURE]` draws it: FILE.png beside it, or PICTURE (.png, .svg).
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .errors import LitheError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NEXT = "next: lithe incident list names those that are there"


def load(path: str | Path) -> tuple[dict[str, Any], npt.NDArray[Any]]:
    """The summary and the telemetry of an incident, given its .npy or its .json.

    Telemetry: one row per tick, oldest first; fields and units as in docs/reference/wire.md, joint arrays (joints,).
    Raises LitheError when one of the two files is not there or damaged.
    """
    at = Path(path)
    try:
        summary = json.loads(at.with_suffix(".json").read_text(encoding="utf-8"))
        records = np.load(at.with_suffix(".npy"), allow_pickle=False)
    except (OSError, ValueError) as error:
        raise LitheError(f"cannot read the incident {at.with_suffix('')}: {error}\n  {_NEXT}") from None
    if not isinstance(summary, dict) or "t_ns" not in summary or records.dtype.names is None:
        raise LitheError(f"{at.with_suffix('')} is no incident\n  {_NEXT}")
    return summary, records


def figure(path: str | Path, most_joints: int = 32) -> Figure:
    """Position, setpoint and torque around the moment, of the joints with the largest errors."""
    from matplotlib.figure import Figure

    summary, records = load(path)
    at_s = 1e-9 * (records["release_ns"] - summary["t_ns"])
    joints = list(enumerate(summary.get("joints", [])))
    worst = sorted(joints, key=lambda one: -float(one[1].get("largest_error_rad") or 0.0))[:most_joints]
    drawn = Figure(figsize=(11, 2.2 * len(worst) + 1.4))
    axes = drawn.subplots(max(len(worst), 1), 2, sharex=True, squeeze=False)
    for row, (j, joint) in enumerate(sorted(worst, key=lambda one: one[0])):
        angle, torque = axes[row]
        angle.plot(at_s, np.degrees(records["setpoint_position_rad"][:, j]), label="setpoint", linewidth=1)
        angle.plot(at_s, np.degrees(records["position_rad"][:, j]), label="position", linewidth=1)
        angle.set_ylabel(f"{joint['name']} [deg]".replace("$", r"\$"))
        torque.plot(at_s, records["command_torque_nm"][:, j], label="torque, after the guard", linewidth=1)
        torque.set_ylabel("[N m]")
        for axis in (angle, torque):
            axis.axvline(0, color="0.6", linewidth=1)
            axis.legend(fontsize="small")
    for axis in axes[-1]:
        axis.set_xlabel("time from the incident [s]")
    drawn.suptitle(str(summary.get("what", ""))[:160].replace("$", r"\$"), fontsize="small")
    drawn.tight_layout()
    return drawn


def plot(path: str | Path, out: str | Path | None = None) -> Path:
    """Draws position, setpoint and torque of each joint around the moment; returns the picture's path.

    LitheError: there is no such incident, or the picture cannot be written.
    """
    picture = Path(out) if out else Path(path).with_suffix(".png")
    if picture.suffix.lower() not in (".png", ".svg"):
        raise LitheError(f"{picture}: a picture is a .png or a .svg\n  next: give such a name")
    drawn = figure(path)
    try:
        drawn.savefig(picture)
    except OSError as error:
        raise LitheError(f"{picture} cannot be written: {error.strerror}\n  next: give another place") from None
    return picture


def main(words: list[str]) -> int:
    """Exit code 0; 1 when there is no such incident, or no such picture can be made."""
    parser = argparse.ArgumentParser(prog="python -m lithe.incident", description="Draws an incident.")
    parser.add_argument("incident", type=Path, help="its .npy or .json; lithe incident show names it")
    parser.add_argument("--out", type=Path, help="the picture, .png or .svg (default: beside the incident)")
    asked = parser.parse_args(words)
    try:
        print(plot(asked.incident, asked.out))
    except LitheError as error:
        print(f"lithe.incident: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
