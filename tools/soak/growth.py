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
STEP_KB = 1024.0
BLOCKS = 20  # of a life; one median each, because neighbouring samples are alike
TWO_SIDED = 2.1  # Student's t, 95 %, for about that many blocks
MOST = {"rss_kb": 2048.0, "fds": 4.0, "segments": 0.5}  # more growth than this is no noise
MOST_KB_PER_CERTIFICATE = 64.0
Sample = tuple[int, float, float]  # whose (pid, or 0), when [s], value


def growth(samples: list[Sample], warm_s: float = WARM_S, one_step: bool = False) -> dict[str, float] | None:
    """One slope through all lives of a process, each with a level of its own; None when no life is long enough.

    Per hour, with its 95 % interval; `span_s`: the longest time that was judged, `most`: the largest value. `one_step`:
    a step above STEP_KB that is more than half of what a life gained does not count; `step` is the largest of them.
    """
    lives: dict[int, list[tuple[float, float]]] = defaultdict(list)
    for life, t_s, value in samples:
        lives[life].append((t_s, value))
    times: list[float] = []
    values: list[float] = []
    spans: list[float] = []
    left_out = 0.0
    for each in lives.values():
        points = np.array([(t, v) for t, v in each if t >= each[0][0] + warm_s])
        if len(points) < BLOCKS or np.ptp(points[:, 0]) < LEAST_S:
            continue
        blocks = [np.median(block, axis=0) for block in np.array_split(points, BLOCKS)]
        t_s, value = np.array(blocks).T
        if one_step:
            at = int(np.argmax(np.diff(value))) + 1
            step = float(value[at] - value[at - 1])
            if step > max(STEP_KB, 0.5 * np.ptp(value)):
                value[at:] -= step
                left_out = max(left_out, step)
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
    told = {"per_hour": slope, "low": low, "high": high, "span_s": max(spans), "most": most}
    return told | {"step": left_out} if one_step else told


def judged(series: dict[str, list[Sample]]) -> dict[str, Any]:
    """The growth of every series for the report. Raises Broken when one has surely grown by more than its noise."""
    told: dict[str, Any] = {}
    for name, samples in series.items():
        # Of memory, once in a life: a supervisor gained 5.3 MB at once after 22 and 25 min, nothing more in the rest of
        # 36 min; the cause is not known. A slope through such a step says nothing of hours. What leaks makes more.
        warm_s = WARM_SUPERVISOR_S if name == "supervisor_rss_kb" else WARM_S
        found = growth(samples, warm_s, one_step=name.endswith("rss_kb"))
        told[name] = found or "not judged: no process lived long enough"
        limit = next((most for kind, most in MOST.items() if name.endswith(kind)), None)
        if found and limit is not None and found["low"] * found["span_s"] / 3600 > limit:
            span = f"{found['low']:.1f} to {found['high']:.1f} an hour, over {found['span_s']:.0f} s"
            raise Broken("growth", f"{name} grows by {found['per_hour']:.1f} an hour ({span})")
    return told


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
