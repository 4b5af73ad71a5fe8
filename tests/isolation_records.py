# SPDX-License-Identifier: Apache-2.0
"""Records of the isolation bench, made for its tests."""

import importlib
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

ROOT = Path(__file__).parents[1]


def module(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """bench.isolation.NAME, found as in a checkout."""
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module(f"bench.isolation.{name}")


def records(figures: ModuleType, late_us: Any, switches: int = 0, stolen_us: float = 0) -> npt.NDArray[Any]:
    """Releases that were so late."""
    made = np.zeros(len(late_us), figures.RECORD)
    made["late_ns"] = np.asarray(late_us) * 1e3
    made["work_ns"] = 8_000
    made["handoff_ns"], made["switches"], made["stolen_ns"] = 10_000, switches, stolen_us * 1e3
    return made
