# SPDX-License-Identifier: Apache-2.0
"""The same laws, replaced in the usual ways: controls bench_swap_peers and reads its ticks."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from lithe.demo.losses import Releases, releases
from lithe.programs import ROOT, binary

from bench.asked import Asked
from bench.swap.stats import AFTER_NS, Round

PERIOD_NS = 1_000_000
GAP_TICKS = 5
# TickRecord of bench/swap/peers.cpp
RECORD = np.dtype(
    [("release_ns", "<i8"), ("woke_ns", "<i8"), ("output_ns", "<i8"), ("skipped", "<u4"), ("switches", "<u4"),
     ("faults", "<u4"), ("pad", "<u4"), ("torque_nm", "<f8")]
)  # fmt: skip


def compile_command(source: Path, library: Path) -> list[str]:
    """Builds a law as a shared object, like a usual plugin."""
    contract = ROOT / "spine/law/include"
    return ["g++", "-std=c++20", "-O2", "-shared", "-fPIC", "-fno-gnu-unique", "-fvisibility=hidden", "-fno-exceptions",
            f"-I{contract}", "-o", str(library), str(source)]  # fmt: skip


def build_laws(sources: list[Path], folder: Path) -> list[Path]:
    """Shared objects of the laws."""
    libraries = [folder / f"{source.stem}.so" for source in sources]
    for source, library in zip(sources, libraries, strict=True):
        subprocess.run(compile_command(source, library), check=True)
    return libraries


@dataclass
class Way:
    """The results of one way of swapping so far."""

    rounds: list[Round] = field(default_factory=list)
    ticks: list[npt.NDArray[Any]] = field(default_factory=list)
    swap_ns: list[int] = field(default_factory=list)  # from request to end

    def releases(self) -> Releases:
        """All releases, including skipped ones."""
        parts = [releases(shaped(part), PERIOD_NS) for part in self.ticks]
        return Releases(
            np.concatenate([part.due_ns for part in parts]),
            np.concatenate([part.late_ns for part in parts]),
            np.concatenate([part.skipped for part in parts]),
        )


def shaped(told: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """With the field names of telemetry."""
    ticks: Any = told  # mypy takes 15 s for the types of what follows
    out: Any = np.zeros(
        len(ticks),
        [("tick", "<i8"), ("release_ns", "<i8"), ("release_jitter_ns", "<i8"), ("missed_releases", "<i8"),
         ("output_late_ns", "<i8"), ("torque_nm", "<f8"), ("active", "?")],
    )  # fmt: skip
    out["missed_releases"] = np.cumsum(ticks["skipped"])
    out["tick"] = np.arange(len(ticks)) + out["missed_releases"]
    out["release_ns"] = ticks["release_ns"]
    out["release_jitter_ns"] = ticks["woke_ns"] - ticks["release_ns"]
    out["output_late_ns"] = ticks["output_ns"] - ticks["release_ns"]
    out["torque_nm"] = ticks["torque_nm"]
    out["active"] = True
    shaped_ticks: npt.NDArray[Any] = out
    return shaped_ticks


class Peers(Asked):
    """The program that swaps in the usual ways, on a separate core."""

    def __init__(self, core: int, loader_core: int, sources: list[Path], folder: Path) -> None:
        self.ways: dict[str, Way] = {}
        self._file = folder / "peers.ticks"
        self._read = 0
        libraries = build_laws(sources, folder)
        compile_one = " ".join(f"'{word}'" for word in compile_command(sources[0], folder / "control.so"))
        words = [str(core), str(loader_core), str(self._file), compile_one, *map(str, libraries)]
        super().__init__("bench_swap_peers", [str(binary("bench_swap_peers")), *words], session=True)

    def run(self, name: str, swaps: int, pause_ticks: int, gap_ticks: int = GAP_TICKS) -> int:
        """One group of swaps and the pause after it; returns the number of swaps done."""
        asked = self.ask(f"{name} {swaps} {gap_ticks} {pause_ticks + AFTER_NS // PERIOD_NS}")["windows"]
        with self._file.open("rb") as file:
            file.seek(self._read * RECORD.itemsize)
            ticks = np.fromfile(file, RECORD)
        self._read += len(ticks)
        way = self.ways.setdefault(name, Way())
        way.ticks.append(ticks)
        way.swap_ns += [done - since for since, done in asked]
        calm_ns = asked[-1][1] + AFTER_NS
        way.rounds.append(Round((asked[0][0], calm_ns), (calm_ns, int(ticks["release_ns"][-1])), len(asked)))
        return len(asked)
