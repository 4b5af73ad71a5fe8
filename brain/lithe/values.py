# SPDX-License-Identifier: Apache-2.0
"""A law's numbers while it runs: parameters, which are tried, the Brain's inputs, which are not, and its State.

Threads: may be shared. Errors: LitheError, Refused.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ._wire import StateKind
from .errors import LitheError, Refused, ShmError

if TYPE_CHECKING:
    from .robot import Robot
    from .shm import SpineView


class Params:
    """Live parameters of the running law: `robot.params["kp_nm_rad"] = 8.0`, or several at once with set()."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    def get(self) -> dict[str, dict[str, float]]:
        """Name -> {value, min, max}."""
        answer = self._robot.call("params")
        return {entry["name"]: {key: entry[key] for key in ("value", "min", "max")} for entry in answer["params"]}

    def set(self, **values: float) -> Any:
        """Sets all of them in one tick after they have passed the trial, or none."""
        return self._robot.call("set_params", values=values)

    def revert(self) -> Any:
        """The values before the last change; a second time, that change again."""
        return self._robot.call("revert_params")

    def __getitem__(self, name: str) -> float:
        params = self.get()
        if name not in params:
            raise LitheError(f"the running law has no parameter '{name}'\n  next: one of {', '.join(params)}")
        return params[name]["value"]

    def __setitem__(self, name: str, value: float) -> None:
        self.set(**{name: value})


def ranges_of(spine: SpineView) -> dict[str, tuple[float, float]]:
    """Name -> (min, max) of the robot's inputs, in the order of `input` in telemetry."""
    names = np.array(spine.info["input_name"]).reshape(-1)[: int(spine.info["input_count"])]
    ranges = zip(spine.info["input_min"].tolist(), spine.info["input_max"].tolist(), strict=True)
    return {bytes(name).decode(): each for name, each in zip(names, ranges, strict=False)}


class Inputs:
    """Numbers for the law beside the plan (`[[input]]` of the robot file): `robot.inputs["forward_m_s"] = 0.3`.

    A law reads them as `t.input[i]`, from the next tick on; they are not tried. They are stale after `[brain]
    stale_after_s`: the law then has the flag kInputStale, and the last values.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._sent: tuple[SpineView, dict[str, float]] | None = None  # and to which run of the robot

    def get(self) -> dict[str, dict[str, float]]:
        """Name -> {value, min, max}; the value that the law had in the newest tick."""
        spine = self._robot.spine
        record = spine.latest()
        values = spine.info["input_value"] if record is None else record["input"]
        return {
            name: {"value": float(value), "min": least, "max": most}
            for (name, (least, most)), value in zip(ranges_of(spine).items(), values, strict=False)
        }

    def check(self, **values: float) -> None:
        """Refused (`unknown_input`, `refused_range`) when one does not exist or is out of its range."""
        ranges = ranges_of(self._robot.spine)
        for name, value in values.items():
            if name not in ranges:
                known = ", ".join(ranges) or "none: declare it as [[input]] in the robot file"
                raise Refused("unknown_input", f"the robot has no input '{name}'", f"one of {known}")
            least, most = ranges[name]
            if not least <= value <= most:
                raise Refused(
                    "refused_range", f"{name} = {value:g}, allowed {least:g} to {most:g}", "a value in its range"
                )

    def set(self, **values: float) -> None:
        """Sends all inputs in one tick: these, and the others as they were sent last; without arguments, to stay fresh.

        Refused as by check(); then none is sent.
        """
        robot = self._robot
        with robot._lock:
            writer, spine = robot._check(), robot.spine
            self.check(**values)
            if self._sent is None or self._sent[0] is not spine:
                self._sent = spine, {name: each["value"] for name, each in self.get().items()}
            self._sent[1].update(values)
            writer.write_inputs(list(self._sent[1].values()))

    def __getitem__(self, name: str) -> float:
        return self.get()[name]["value"]

    def __setitem__(self, name: str, value: float) -> None:
        self.set(**{name: value})


NUMBERS = {
    StateKind.boolean: "?",
    StateKind.i8: "i1",
    StateKind.u8: "u1",
    StateKind.i16: "<i2",
    StateKind.u16: "<u2",
    StateKind.i32: "<i4",
    StateKind.u32: "<u4",
    StateKind.i64: "<i8",
    StateKind.u64: "<u8",
    StateKind.f32: "<f4",
    StateKind.f64: "<f8",
}


def fields_of(law: npt.NDArray[Any], state: bytes) -> dict[str, Any]:
    """The fields of a State by name; `law` (LawInfo) describes the layout."""
    fields: dict[str, Any] = {}
    for i in range(int(law["state_field_count"])):
        kind, elements = StateKind(law["state_kind"][i]), int(law["state_elements"][i])
        name, start = law["state_name"][i].decode(errors="replace"), int(law["state_offset"][i])
        if start + elements * np.dtype(NUMBERS[kind]).itemsize > len(state):
            raise ShmError(f"field '{name}' lies outside the State it belongs to: restart the robot")
        values = np.frombuffer(state, NUMBERS[kind], elements, start).copy()
        fields[name] = values[0].item() if elements == 1 else values
    return fields
