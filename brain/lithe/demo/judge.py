# SPDX-License-Identifier: Apache-2.0
"""Turns a recording and what the agent said into the summary. Whether the claim holds says verdict.py."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lithe._wire import TelemetryFlags

from . import losses
from .evidence import NONE, Evidence, tally
from .joints import REST_S, SimJoint, error_deg, freeze_of, interval_of, mgl_error, rms

CORES = os.sched_getaffinity(0)  # before the experiment keeps off the Spine's
ROLES = ("spine", "transport", "brain", "housekeeping")
PHASES = ("baseline", "probing", "gravity_only", "evolved", "frozen", "resumed", "reattached")
# A swap's window reaches from the agent's request to 50 ms after the commit. All of it is judged: also while a compiler
# is at work on another core. The hand-over in it (loading, commit, retiring the old law, which is all that the Spine's
# process does) is compared with the rest of the run by itself too, because a loss there would drown in the whole.
BEFORE_COMMIT_NS = 20_000_000
AFTER_COMMIT_NS = 50_000_000
SLICE_NS = 1_000_000_000  # of the run, each held against what the machine took in it


@dataclass
class Story:
    """What happened when, CLOCK_MONOTONIC ns."""

    phases: list[dict[str, Any]] = field(default_factory=list)  # name, from_ns, to_ns
    swaps: list[dict[str, Any]] = field(default_factory=list)  # records of the supervisor, with `law` and `sent_ns`
    estimates: list[dict[str, Any]] = field(default_factory=list)  # of each joint, in order
    reference: dict[str, Any] = field(default_factory=dict)  # the sines, as the agent asked for them last
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


def quantiles_us(values_ns: npt.NDArray[Any]) -> dict[str, float]:
    """p50, p99, p99.9 and the maximum [us]."""
    p50, p99, p999 = np.percentile(values_ns, [50, 99, 99.9]) / 1e3
    return {"p50": float(p50), "p99": float(p99), "p999": float(p999), "max": float(np.max(values_ns) / 1e3)}


def largest_step(records: npt.NDArray[Any], tick: int, bounds_nm: npt.NDArray[np.float64]) -> dict[str, Any]:
    """Of the joint whose commanded torque changed most around a swap, from tick to tick, for what the guard allows."""
    near = records[np.abs(records["tick"].astype(np.int64) - tick) <= 3]
    steps_nm = np.full(len(bounds_nm), np.nan)
    if len(near) > 1:
        steps_nm = np.max(np.abs(np.diff(near["command_torque_nm"][:, : len(bounds_nm)], axis=0)), axis=0)
    worst = int(np.argmax(steps_nm / bounds_nm))  # a NaN is the largest
    return {
        "output_step_nm": float(steps_nm[worst]),
        "output_step_bound_nm": float(bounds_nm[worst]),
        "output_step_joint": worst,
    }


def machine(robot_info: Any) -> dict[str, Any]:
    """What the numbers were measured on."""
    model = platform.machine()
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith(("model name", "Model")):
            model = line.split(":", 1)[1].strip()
            break
    return {
        "cpu": model,
        # Isolated cores are in no affinity but of those who asked for them: the robot.
        "cores": len(CORES | {int(robot_info[f"cpu_{role}"]) for role in ROLES}),
        "kernel": platform.release(),
        "hypervisor": "hypervisor" in Path("/proc/cpuinfo").read_text(encoding="utf-8"),
        "privileges": "root" if os.geteuid() == 0 else "ordinary user",
        "spine_cpu": int(robot_info["cpu_spine"]),
        "transport": "in the tick thread"
        if robot_info["transport_inline"]
        else f"core {int(robot_info['cpu_transport'])}",
        "lost": bytes(robot_info["notes"]).split(b"\0", 1)[0].decode(errors="replace"),
    }


def judge_phases(records: npt.NDArray[Any], story: Story, judged: list[int]) -> list[dict[str, Any]]:
    """The error of all joints under gravity together."""
    phases = []
    for phase in story.phases:
        part = between(records, phase["from_ns"], phase["to_ns"])
        rmse = rms(np.array([error_deg(part, joint) for joint in judged]))
        phases.append({"name": phase["name"], "rmse_deg": rmse, "seconds": (phase["to_ns"] - phase["from_ns"]) * 1e-9})
    return phases


def judge_joints(records: npt.NDArray[Any], story: Story, sims: list[SimJoint]) -> list[dict[str, Any]]:
    """Each joint by itself."""
    frozen = between(records, *story.freeze_ns)
    rest = between(records, story.freeze_ns[1] - int(REST_S * 1e9), story.freeze_ns[1])
    parts = {phase["name"]: between(records, phase["from_ns"], phase["to_ns"]) for phase in story.phases}
    return [
        {
            "name": sim.name,
            "bears_gravity": sim.bears_gravity,
            "mgl_true_nm": sim.mgl_nm,
            "mgl_hat_nm": float(estimate["mgl_hat_nm"]),
            "mgl_error": mgl_error(float(estimate["mgl_hat_nm"]), sim),
            **interval_of(estimate, sim),
            "estimate": estimate,
            "rmse_deg": {name: rms(error_deg(part, joint)) for name, part in parts.items()},
            "freeze": freeze_of(joint, frozen, rest, sim),
        }
        for joint, (sim, estimate) in enumerate(zip(sims, story.estimates, strict=True))
    ]


def span_of(records: npt.NDArray[Any]) -> losses.Window:
    return int(records["release_ns"][0]), int(records["release_ns"][-1]) + 1


def judge_swaps(
    records: npt.NDArray[Any], story: Story, made: losses.Releases, bounds_nm: npt.NDArray[np.float64]
) -> tuple[list[dict[str, Any]], list[losses.Window], list[losses.Window]]:
    """Each swap; the windows from request to commit of all of them, and of their hand-overs."""
    swaps, whole, handovers = [], [], []
    for swap in story.swaps:
        tick = int(swap["commit_tick"])
        commit_ns = losses.commit_ns(records, tick)
        window = (int(swap["sent_ns"]), commit_ns + AFTER_COMMIT_NS)
        handover = (max(window[0], commit_ns - BEFORE_COMMIT_NS), window[1])
        whole.append(window)
        handovers.append(handover)
        swaps.append(
            {
                "law": swap["law"],
                "compile_ms": float(swap["compile_ms"]),
                "load_ms": float(swap["load_ms"]),
                "cached": bool(swap["cached"]),
                "requested_to_committed_ms": float(swap["requested_to_committed_ms"]),
                "split_ms": {stage: float(ms) for stage, ms in swap["split_ms"].items()},
                "commit_tick": tick,
                "window_ms": (window[1] - window[0]) * 1e-6,
                "lost_ticks": made.lost_in(window),
                "lost_ticks_prepare": made.lost_in((window[0], handover[0])),
                "lost_ticks_commit": made.lost_in(handover),
                **largest_step(records, tick, bounds_nm),
            }
        )
    return swaps, whole, handovers


def judge_timing(
    records: npt.NDArray[Any],
    made: losses.Releases,
    windows: tuple[list[losses.Window], list[losses.Window]],
    evidence: Evidence,
    period_ns: int,
) -> dict[str, Any]:
    """Missed releases, in which a tick was lost or ended too late: of the run, of the swaps, and whose fault they are.

    `windows`: from request to commit, and the hand-overs. Both are compared with windows of the same run without a swap
    by Fisher's exact test; the former in pieces of the hand-overs' length.
    """
    whole, handovers = windows
    missed = losses.with_missed_deadlines(made, records)
    span, length_ns = span_of(records), BEFORE_COMMIT_NS + AFTER_COMMIT_NS
    others = losses.elsewhere(span, whole, length_ns)
    pieces = [piece for window in whole for piece in losses.elsewhere(window, [], length_ns)]
    return {
        "swap_windows": losses.tally(missed, whole),
        "commit_windows": losses.tally(missed, handovers),
        "no_swap_windows": losses.tally(missed, others),
        "timing": {
            "run": tally(missed, losses.slices(span, SLICE_NS), evidence, period_ns),
            "swaps": tally(missed, whole, evidence, period_ns)
            | {"chance": losses.compare(missed, pieces, others).chance},
            "commits": tally(missed, handovers, evidence, period_ns)
            | {"chance": losses.compare(missed, handovers, others).chance},
            **evidence.told(),
        },
    }


def judge_freeze(
    records: npt.NDArray[Any], freeze_ns: tuple[int, int], joints: list[dict[str, Any]]
) -> dict[str, float]:
    """How the robot held without its Brain: the largest excursion, and the rest of the joint that bore least."""
    frozen = between(records, *freeze_ns)
    least = min(joints, key=lambda joint: float(np.nan_to_num(joint["freeze"]["gravity_share"], nan=-1.0)))
    return {
        "duration_s": (freeze_ns[1] - freeze_ns[0]) * 1e-9,
        "brain_silent_s": float(np.max(frozen["brain_age_ns"])) * 1e-9 if len(frozen) else float("nan"),
        **least["freeze"],
        "max_excursion_deg": float(np.max([joint["freeze"]["max_excursion_deg"] for joint in joints])),
    }


def summarise(
    records: npt.NDArray[Any],
    story: Story,
    sims: list[SimJoint],
    robot_info: Any,
    lost_records: int,
    evidence: Evidence = NONE,
) -> dict[str, Any]:
    """All of it. What stands beside `joints` is of the joints under gravity together, or of the worst of them."""
    rate_hz = float(robot_info["rate_hz"])
    period_ns = round(1e9 / rate_hz)
    made = losses.releases(records, period_ns)
    bounds_nm = np.asarray(robot_info["torque_slew_nm_s"][: len(sims)], dtype=np.float64) / rate_hz
    swaps, *windows = judge_swaps(records, story, made, bounds_nm)
    joints = judge_joints(records, story, sims)
    heavy = [joint for joint in joints if joint["bears_gravity"]]
    worst = max(heavy, key=lambda joint: float(np.nan_to_num(joint["mgl_error"], nan=np.inf)))
    return {
        "rate_hz": rate_hz,
        "joints": joints,
        "phases": judge_phases(records, story, [j for j, sim in enumerate(sims) if sim.bears_gravity]),
        **{key: worst[key] for key in ("mgl_true_nm", "mgl_hat_nm", "mgl_error", "mgl_interval_nm", "estimate")},
        "swaps": swaps,
        **judge_timing(records, made, (windows[0], windows[1]), evidence, period_ns),
        "output_step_bound_nm": float(bounds_nm[0]),
        "ticks": int(records["tick"][-1] - records["tick"][0] + 1),
        "lost_ticks": int(records["missed_releases"][-1] - records["missed_releases"][0]),
        "missed_deadlines": int(np.count_nonzero(records["flags"] & TelemetryFlags.deadline_missed)),
        "late_samples": int(records["late_samples"][-1] - records["late_samples"][0]),
        "records_lost": lost_records,
        "handoff_us": quantiles_us(records["handoff_ns"]),
        "release_jitter_us": quantiles_us(made.late_ns),  # a skipped release counts as late
        "tick_us": quantiles_us(records["tick_ns"]),
        "freeze": judge_freeze(records, story.freeze_ns, heavy),
        "kill": {"seconds_without_brain": (story.kill_ns[1] - story.kill_ns[0]) * 1e-9},
        "machine": machine(robot_info),
    }
