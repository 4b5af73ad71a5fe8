# SPDX-License-Identifier: Apache-2.0
"""Turns a recording and what the agent said into the summary, and says whether the claim holds."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

SWAP_WINDOW_TICKS = 50
CORES = len(os.sched_getaffinity(0))  # before the experiment keeps off the Spine's
REST_TICKS = 700
MOST_MGL_ERROR = 0.05
MOST_EVOLVED_DEG = 3.0
LEAST_IMPROVEMENT = 8.0
MOST_EXCURSION_DEG = 5.0


@dataclass
class Story:
    """What happened when, CLOCK_MONOTONIC ns."""

    phases: list[dict[str, Any]] = field(default_factory=list)  # name, from_ns, to_ns
    swaps: list[dict[str, Any]] = field(default_factory=list)  # records of the supervisor, with `law`
    estimate: dict[str, Any] = field(default_factory=dict)
    sent_ns: list[int] = field(default_factory=list)  # when the agent asked for each swap
    freeze_ns: tuple[int, int] = (0, 0)
    kill_ns: tuple[int, int] = (0, 0)  # killed, and the new Brain's first plan
    source: str = ""

    def begin(self, name: str, from_ns: int) -> None:
        self.end(from_ns)
        self.phases.append({"name": name, "from_ns": from_ns, "to_ns": 0})

    def end(self, to_ns: int) -> None:
        if self.phases and not self.phases[-1]["to_ns"]:
            self.phases[-1]["to_ns"] = to_ns


def between(records: npt.NDArray[Any], from_ns: int, to_ns: int) -> npt.NDArray[Any]:
    part: npt.NDArray[Any] = records[(records["release_ns"] >= from_ns) & (records["release_ns"] < to_ns)]
    return part


def error_deg(records: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Setpoint minus position of the first joint [deg]."""
    error: npt.NDArray[np.float64] = np.degrees(records["setpoint_position_rad"][:, 0] - records["position_rad"][:, 0])
    return error


def quantiles_us(values_ns: npt.NDArray[Any]) -> dict[str, float]:
    """p50, p99, p99.9 and the maximum [us]."""
    p50, p99, p999 = np.percentile(values_ns, [50, 99, 99.9]) / 1e3
    return {"p50": float(p50), "p99": float(p99), "p999": float(p999), "max": float(np.max(values_ns) / 1e3)}


def lost_in_window(records: npt.NDArray[Any], tick: int) -> int:
    """Releases skipped within 50 ticks of `tick`."""
    near = records[np.abs(records["tick"].astype(np.int64) - tick) <= SWAP_WINDOW_TICKS]
    return int(near["missed_releases"][-1] - near["missed_releases"][0]) if len(near) else 0


def lost_elsewhere(records: npt.NDArray[Any], swap_ticks: list[int]) -> dict[str, float]:
    """The same count in every other window of that length, for comparison."""
    length = 2 * SWAP_WINDOW_TICKS + 1
    ticks = records["tick"].astype(np.int64)
    losses = []
    for start in range(0, len(records) - length, length):
        if all(abs(int(ticks[start + length // 2]) - tick) > length for tick in swap_ticks):
            losses.append(int(records["missed_releases"][start + length - 1] - records["missed_releases"][start]))
    return {"windows": len(losses), "lost_ticks": int(sum(losses)), "windows_with_loss": int(np.count_nonzero(losses))}


def largest_step_nm(records: npt.NDArray[Any], tick: int) -> float:
    """Largest change of the commanded torque from one tick to the next around a swap [N m]."""
    near = records[np.abs(records["tick"].astype(np.int64) - tick) <= 3]
    return float(np.max(np.abs(np.diff(near["command_torque_nm"][:, 0])))) if len(near) > 1 else 0.0


def machine(robot_info: Any) -> dict[str, Any]:
    """What the numbers were measured on."""
    model = platform.machine()
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith(("model name", "Model")):
            model = line.split(":", 1)[1].strip()
            break
    return {
        "cpu": model,
        "cores": CORES,
        "kernel": platform.release(),
        "hypervisor": "hypervisor" in Path("/proc/cpuinfo").read_text(encoding="utf-8"),
        "privileges": "root" if os.geteuid() == 0 else "ordinary user",
        "spine_cpu": int(robot_info["cpu_spine"]),
        "transport": "in the tick thread"
        if robot_info["transport_inline"]
        else f"core {int(robot_info['cpu_transport'])}",
        "lost": bytes(robot_info["notes"]).split(b"\0", 1)[0].decode(errors="replace"),
    }


def summarise(
    records: npt.NDArray[Any], story: Story, mgl_true_nm: float, robot_info: Any, lost_records: int
) -> dict[str, Any]:
    phases = []
    for phase in story.phases:
        part = between(records, phase["from_ns"], phase["to_ns"])
        rmse = float(np.sqrt(np.mean(error_deg(part) ** 2))) if len(part) else float("nan")
        phases.append({"name": phase["name"], "rmse_deg": rmse, "seconds": (phase["to_ns"] - phase["from_ns"]) * 1e-9})
    swaps = []
    for swap in story.swaps:
        tick = int(swap["commit_tick"])
        swaps.append(
            {
                "law": swap["law"],
                "compile_ms": float(swap["compile_ms"]),
                "cached": bool(swap["cached"]),
                "requested_to_committed_ms": float(swap["requested_to_committed_ms"]),
                "commit_tick": tick,
                "lost_ticks": lost_in_window(records, tick),
                "output_step_nm": largest_step_nm(records, tick),
            }
        )
    frozen = between(records, *story.freeze_ns)
    rest = frozen["position_rad"][-REST_TICKS:, 0]  # the plan has run out and the setpoint has coasted to a stop
    mgl_hat = float(story.estimate["mgl_hat_nm"])
    deadline_flag = 512
    return {
        "rate_hz": float(robot_info["rate_hz"]),
        "phases": phases,
        "mgl_true_nm": mgl_true_nm,
        "mgl_hat_nm": mgl_hat,
        "mgl_error": abs(mgl_hat - mgl_true_nm) / mgl_true_nm,
        "estimate": story.estimate,
        "swaps": swaps,
        "no_swap_windows": lost_elsewhere(records, [swap["commit_tick"] for swap in swaps]),
        "output_step_bound_nm": float(robot_info["torque_slew_nm_s"][0]) / float(robot_info["rate_hz"]),
        "ticks": int(records["tick"][-1] - records["tick"][0] + 1),
        "lost_ticks": int(records["missed_releases"][-1] - records["missed_releases"][0]),
        "missed_deadlines": int(np.count_nonzero(records["flags"] & deadline_flag)),
        "late_samples": int(records["late_samples"][-1] - records["late_samples"][0]),
        "records_lost": lost_records,
        "handoff_us": quantiles_us(records["handoff_ns"]),
        "release_jitter_us": quantiles_us(records["release_jitter_ns"]),
        "tick_us": quantiles_us(records["tick_ns"]),
        "freeze": {
            "duration_s": (story.freeze_ns[1] - story.freeze_ns[0]) * 1e-9,
            "max_excursion_deg": float(np.max(np.abs(error_deg(frozen)))),
            "rest_angle_deg": float(np.degrees(rest[-1])),
            "rest_sag_deg": float(np.degrees(np.ptp(rest))),
            "gravity_share": float(abs(np.sin(rest[-1]))),
        },
        "kill": {"seconds_without_brain": (story.kill_ns[1] - story.kill_ns[0]) * 1e-9},
        "machine": machine(robot_info),
    }


def verdict(summary: dict[str, Any]) -> list[str]:
    """What falls short, one sentence each; empty when the claim holds."""
    rmse = {phase["name"]: phase["rmse_deg"] for phase in summary["phases"]}
    wrong = [
        f"phase '{name}' is missing"
        for name in ("baseline", "probing", "evolved", "frozen", "resumed", "reattached")
        if name not in rmse
    ]
    if summary["mgl_error"] > MOST_MGL_ERROR:
        wrong.append(f"mgl is off by {summary['mgl_error']:.1%}, more than {MOST_MGL_ERROR:.0%}")
    for name in ("evolved", "resumed", "reattached"):
        if not rmse.get(name, np.inf) <= min(MOST_EVOLVED_DEG, rmse.get("baseline", 0.0) / LEAST_IMPROVEMENT):
            wrong.append(
                f"RMSE {name} {rmse.get(name, np.nan):.2f} deg, baseline {rmse.get('baseline', np.nan):.1f} deg"
            )
    if summary["freeze"]["max_excursion_deg"] > MOST_EXCURSION_DEG:
        wrong.append(f"the frozen arm moved {summary['freeze']['max_excursion_deg']:.1f} deg off its setpoint")
    return wrong
