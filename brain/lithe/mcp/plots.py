# SPDX-License-Identifier: Apache-2.0
"""Pictures of what the robot did, drawn when they are asked for, from what the gateway answers.

Threads: one picture at a time. matplotlib is loaded at the first.
"""

from __future__ import annotations

import base64
import io
import json
import re
import threading
from collections.abc import Callable
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import incident
from ..errors import LitheError, Refused
from ..vocabulary import nearest
from .protocol import Json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Call = Callable[[str, Json], Any]
TYPE = "image/png"
MOST_BYTES = 256 << 10
MOST_JOINTS = 6  # the worst
MOST_SWAPS = 30  # the newest
RECENT_S, RECENT_HZ = 60.0, 50.0
COLOURS = {"confirmed": "tab:green", "rolled_back": "tab:red", "refused": "tab:red"}
ALWAYS = {
    "plots/laws.png": "the history of laws with their scores: rms error of each joint under each law, and the verdict",
    "plots/last-swap.png": "error and torque of each joint under the law before the last measured swap and after it",
    "plots/recent.png": "tracking error of each joint in the last 60 s, and where the law changed",
}
OF_ONE = {
    "plots/swaps/{number}.png": "error and torque of each joint before and after that swap",
    "plots/incidents/{number}.png": "position, setpoint and torque around an incident; {number} as in `incidents`",
}
BARS = {"rms_error_rad": "rms error [rad]", "max_error_rad": "largest error [rad]", "rms_torque_nm": "torque [N m]"}
_NAME = re.compile(r"plots/(swaps|incidents)/([0-9]{1,9})\.png")
_lock = threading.Lock()


def is_one(name: Any) -> bool:
    """Whether the name is meant to be a plot's."""
    return str(name).startswith("plots/")


def drawn(name: str, call: Call) -> str:
    """The picture, base64. Refused: there is none of that name; LitheError: there is nothing to draw yet."""
    with _lock:
        picture = figure(name, call)
        for dots_per_inch in (100, 70, 50):
            png = io.BytesIO()
            picture.savefig(png, format="png", dpi=dots_per_inch)
            if len(png.getvalue()) <= MOST_BYTES:
                return base64.b64encode(png.getvalue()).decode()
    raise LitheError(f"the picture has more than {MOST_BYTES} bytes")


def figure(name: str, call: Call) -> Figure:
    """What drawn() draws."""
    one = _NAME.fullmatch(name)
    if one is None and name not in ALWAYS:
        raise Refused("unknown_document", f"there is no plot '{name}'", nearest(name, {*ALWAYS, *OF_ONE}))
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError:
        raise LitheError("matplotlib is not installed\n  next: pip install matplotlib") from None
    if one is not None:
        return {"swaps": _swap, "incidents": _incident}[one[1]](one[2], call)
    return {"laws": _laws, "last-swap": _last_swap, "recent": _recent}[PurePath(name).stem](call)


def _axes(rows: int, height_in: float, **options: Any) -> tuple[Figure, list[Any]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 1.4 + height_in * rows), layout="constrained")
    return figure, list(figure.subplots(rows, 1, squeeze=False, **options)[:, 0])


def _plain(name: Any) -> str:
    """A name that others gave, without a meaning to matplotlib, and not too long."""
    return str(name)[:24].replace("$", r"\$")


def _swaps(call: Call) -> list[Json]:
    """In short; those that were measured have `joints`."""
    told: list[Json] = json.loads(call("document", {"name": "swaps"})["text"])
    return told


def _laws(call: Call) -> Figure:
    from matplotlib.ticker import LogFormatter

    swaps = _swaps(call)[-MOST_SWAPS:]
    joints = list(dict.fromkeys(name for each in swaps for name in each.get("joints") or {}))[:MOST_JOINTS]
    if not joints:
        raise LitheError("no law was measured yet\n  next: swap one while a reference runs")
    figure, (axis,) = _axes(1, 4.0)
    for joint in joints:
        errors = [((each.get("joints") or {}).get(joint) or {}).get("rms_error_rad") or {} for each in swaps]
        axis.plot([one.get("new") or np.nan for one in errors], marker="o", label=_plain(joint))
    axis.set(yscale="log", ylabel="rms error [rad]", title="laws; green: confirmed, red: not kept")
    axis.yaxis.set_major_formatter(LogFormatter())
    axis.yaxis.set_minor_formatter(LogFormatter(labelOnlyBase=False))
    words = [f"{each['certificate'].removeprefix('swaps/')} {_plain(each.get('law', ''))}" for each in swaps]
    axis.set_xticks(range(len(swaps)), words, rotation=60, ha="right", fontsize="small")
    for label, each in zip(axis.get_xticklabels(), swaps, strict=True):
        label.set_color(COLOURS.get(str(each.get("verdict")), "0.4"))
    axis.legend(fontsize="small")
    return figure


def _last_swap(call: Call) -> Figure:
    measured = [each["certificate"] for each in _swaps(call) if each.get("joints")]
    if not measured:
        raise LitheError("no swap was measured yet\n  next: swap a law while a reference runs")
    return _swap(measured[-1].removeprefix("swaps/"), call)


def _swap(number: str, call: Call) -> Figure:
    told = json.loads(call("document", {"name": f"swaps/{number}"})["text"])
    joints = (told.get("control") or {}).get("joints") or []
    if not joints:
        raise LitheError(f"swap {number} was not measured; its verdict: {told.get('verdict')}")
    joints = sorted(joints, key=lambda one: -(one["after"].get("rms_error_rad") or 0.0))[:MOST_JOINTS]
    figure, axes = _axes(len(BARS), 1.8)
    at = np.arange(len(joints))
    for axis, (key, words) in zip(axes, BARS.items(), strict=True):
        bars = {when: [one[when].get(key) for one in joints] for when in ("before", "after")}
        if key == "rms_error_rad":
            bars["predicted by the trial"] = [one.get("predicted_rms_error_rad") for one in joints]
        for k, (label, values) in enumerate(bars.items()):
            heights = [np.nan if value is None else value for value in values]
            axis.bar_label(axis.bar(at + 0.25 * k, heights, 0.25, label=label), fmt="%.3g", fontsize="x-small")
        axis.set_xticks(at + 0.125 * (len(bars) - 1), [_plain(one["joint"]) for one in joints])
        axis.set(ylabel=words)
        axis.margins(y=0.2)
    axes[0].legend(fontsize="small")
    figure.suptitle(f"swap {number}: {_plain(told.get('law'))}, {told.get('verdict')}")
    return figure


def _recent(call: Call) -> Figure:
    robot = call("describe", {})
    every = max(1, round(robot["rate_hz"] / RECENT_HZ))
    fields = ["tick", "law_id", "setpoint_position_rad", "position_rad"]
    told = call("history", {"seconds": RECENT_S, "every": every, "fields": fields})
    if not told["tick"]:
        raise LitheError("no tick yet\n  next: read it again")
    error_rad = np.array(told["setpoint_position_rad"], float) - np.array(told["position_rad"], float)
    law_id, at_s = np.array(told["law_id"]), (np.array(told["tick"]) - told["tick"][-1]) / robot["rate_hz"]
    worst = sorted(np.argsort(-np.nanmax(np.abs(error_rad), axis=0))[:MOST_JOINTS])
    figure, axes = _axes(len(worst), 1.5, sharex=True)
    for axis, joint in zip(axes, worst, strict=True):
        axis.plot(at_s, error_rad[:, joint], linewidth=0.8)
        axis.set(ylabel=f"{_plain(robot['joints'][joint]['name'])} [rad]")
        for k in np.flatnonzero(np.diff(law_id)):
            axis.axvline(at_s[k + 1], color="tab:red", linewidth=0.8)
    axes[-1].set(xlabel="time [s]; a red line: another law from here on")
    figure.suptitle("setpoint - position")
    return figure


def _incident(number: str, call: Call) -> Figure:
    told = call("incident", {"id": int(number)})
    return incident.figure(Path(told["folder"]) / told["data"], MOST_JOINTS)
