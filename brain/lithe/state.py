# SPDX-License-Identifier: Apache-2.0
"""Converts the State of a law from bytes and a description to names and numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ._wire import StateKind
from .errors import ShmError

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
