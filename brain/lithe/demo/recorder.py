# SPDX-License-Identifier: Apache-2.0
"""Records every tick of the experiment from shared memory, also when other processes die."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lithe._wire import SEGMENTS
from lithe.heartbeat import Repeat
from lithe.shm import SpineView

from .evidence import Evidence, Watch, threads_of

CSV_FIELDS = (
    "tick", "release_ns", "mode", "law_id", "plan_state", "missed_releases",
    "release_jitter_ns", "handoff_ns", "tick_ns",
    "position_rad", "velocity_rad_s", "torque_nm", "setpoint_position_rad", "command_torque_nm",
)  # fmt: skip


class Recorder:
    """Drains the telemetry ring into memory, eight times and more before it is full; so `lost` stays 0.

    At the same times it looks at what the machine takes from the Spine.
    """

    def __init__(self, robot: str) -> None:
        spine = SpineView(robot)
        self._cursor = spine.telemetry()
        self._watch = Watch(threads_of(spine.info, int(spine.mapping.header().writer_pid)))
        ring_s = SEGMENTS["spine"]["telemetry"].depth / float(spine.info["rate_hz"])
        self._pieces: list[npt.NDArray[Any]] = []
        self._looks = Repeat(self._look, min(0.05, ring_s / 8))

    def _look(self) -> None:
        self._pieces.append(self._cursor.drain())
        self._watch.look()

    @property
    def lost(self) -> int:
        return self._cursor.lost

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self._looks.stop()

    def finish(self) -> npt.NDArray[Any]:
        """Stops and returns all records, oldest first."""
        self._looks.stop()
        self._look()
        return np.concatenate(self._pieces)

    def evidence(self) -> Evidence:
        """What the machine took from the Spine; after finish()."""
        return self._watch.evidence()


def joint_columns(records: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
    """Field name -> (n,) or (n, joints), without the unused tails of the joint arrays."""
    joints = int(records["joint_count"][0])
    columns = {}
    for name in records.dtype.names or ():
        values = records[name]
        columns[name] = values[:, :joints] if values.ndim == 2 and name != "probe" else values
    return columns


def save(records: npt.NDArray[Any], folder: Path) -> None:
    """telemetry.npz with every field, telemetry.csv with those people plot."""
    columns = joint_columns(records)
    np.savez_compressed(folder / "telemetry.npz", **columns)  # type: ignore[arg-type]
    names, blocks = [], []
    for name in CSV_FIELDS:
        values = columns[name]
        if values.ndim == 1:
            names.append(name)
            blocks.append(values[:, None])
        else:
            names += [f"{name}[{j}]" for j in range(values.shape[1])]
            blocks.append(values)
    # One format a column keeps 64-bit times exact, which a common float array would not.
    formats = ["%d" if block.dtype.kind in "iu" else "%.6g" for block in blocks for _ in range(block.shape[1])]
    rows = zip(*(column for block in blocks for column in block.T), strict=True)
    with (folder / "telemetry.csv").open("w", encoding="utf-8") as file:
        file.write(",".join(names) + "\n")
        line = ",".join(formats) + "\n"
        file.writelines(line % row for row in rows)
