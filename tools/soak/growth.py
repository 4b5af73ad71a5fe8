# SPDX-License-Identifier: Apache-2.0
"""Whether something grows: samples of processes, shared memory and folders, and the slope through them."""

from __future__ import annotations

import contextlib
import os
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from .judge import Broken

# Of a process's life, before it is judged: its caches fill. The supervisor keeps the last 4096 events: 3 MB.
WARM_S, WARM_SUPERVISOR_S = 60.0, 900.0
LEAST_S = 180.0  # what is left of a life after that; shorter ones say nothing
BLOCKS = 20  # of a life; one median each, because neighbouring samples are alike
TWO_SIDED = 2.1  # Student's t, 95 %, for about that many blocks
MOST = {"rss_kb": 2048.0, "fds": 4.0, "segments": 0.5}  # more growth than this is no noise
MOST_KB_PER_CERTIFICATE = 64.0
# Both live as long as the robot, so both must have been judged before growth counts as checked.
NEEDED = {"spine_rss_kb": "the Spine", "supervisor_rss_kb": "the supervisor"}
Sample = tuple[int, float, float]  # whose (pid, or 0), when [s], value


def growth(samples: list[Sample], warm_s: float = WARM_S) -> dict[str, float] | None:
    """One slope through all lives of a process, each with a level of its own; None when no life is long enough.

    Per hour, with its 95 % interval; `span_s`: the longest time that was judged, `most`: the largest value.
    """
    lives: dict[int, list[tuple[float, float]]] = defaultdict(list)
    for life, t_s, value in samples:
        lives[life].append((t_s, value))
    times: list[float] = []
    values: list[float] = []
    spans: list[float] = []
    for each in lives.values():
        points = np.array([(t, v) for t, v in each if t >= each[0][0] + warm_s])
        if len(points) < BLOCKS or np.ptp(points[:, 0]) < LEAST_S:
            continue
        blocks = [np.median(block, axis=0) for block in np.array_split(points, BLOCKS)]
        t_s, value = np.array(blocks).T
        times += list(t_s - np.mean(t_s))
        values += list(value - np.mean(value))
        spans.append(float(np.ptp(points[:, 0])))
    if not spans:
        return None
    t_h, y = np.array(times) / 3600, np.array(values)
    slope = float(t_h @ y / (t_h @ t_h))
    rest = y - slope * t_h
    error = float(np.sqrt(rest @ rest / (len(y) - len(spans) - 1) / (t_h @ t_h)))
    most = max(value for _, _, value in samples)
    low, high = slope - TWO_SIDED * error, slope + TWO_SIDED * error
    return {"per_hour": slope, "low": low, "high": high, "span_s": max(spans), "most": most}


def judged(series: dict[str, list[Sample]]) -> dict[str, Any]:
    """The growth of every series for the report. Raises Broken when one has surely grown by more than its noise."""
    told: dict[str, Any] = {}
    for name, samples in series.items():
        warm_s = WARM_SUPERVISOR_S if name == "supervisor_rss_kb" else WARM_S
        found = growth(samples, warm_s)
        told[name] = found or "not judged: no process lived long enough"
        limit = next((most for kind, most in MOST.items() if name.endswith(kind)), None)
        if found and limit is not None and found["low"] * found["span_s"] / 3600 > limit:
            span = f"{found['low']:.1f} to {found['high']:.1f} an hour, over {found['span_s']:.0f} s"
            raise Broken("growth", f"{name} grows by {found['per_hour']:.1f} an hour ({span})")
    return told


def not_judged(told: dict[str, Any]) -> str:
    """Why the answer of judged() says nothing of growth; "" if it does."""
    short = [who for name, who in NEEDED.items() if not isinstance(told.get(name), dict)]
    return f"the memory of {' and '.join(short)}: no process lived long enough" if short else ""


def size_kb(folder: Path) -> float:
    """What the files below a folder occupy."""
    total = 0
    for path in folder.rglob("*"):
        with contextlib.suppress(OSError):  # gone meanwhile
            total += path.stat().st_size
    return total / 1024


def of_process(pid: int) -> dict[str, float]:
    """Resident memory and number of file descriptors; {} when it has gone."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        rss_kb = next((float(line.split()[1]) for line in lines if line.startswith("VmRSS:")), None)
        fds = float(len(os.listdir(f"/proc/{pid}/fd")))
    except OSError:
        return {}
    return {} if rss_kb is None else {"rss_kb": rss_kb, "fds": fds}
