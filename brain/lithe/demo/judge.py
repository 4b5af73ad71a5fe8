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

from lithe._wire import TelemetryFlags

from . import losses
from .joints import REST_S, SimJoint, error_deg, freeze_of, mgl_error, rms, shortcomings

CORES = len(os.sched_getaffinity(0))  # before the experiment keeps off the Spine's
PHASES = ("baseline", "probing", "gravity_only", "evolved", "frozen", "resumed", "reattached")
# A swap's window reaches from the agent's request to 50 ms after the commit. All of it is counted and reported, but
# only the hand-over in it is judged: loading (some milliseconds), commit, retiring the old law, which is all that the
# Spine's process does. Before that a compiler is at work on another core. On a machine of two cores, or a virtual one
# whose host counts them together, any program would disturb the Spine as much, and a demo that failed by it would say
# nothing about swaps.
BEFORE_COMMIT_NS = 20_000_000
AFTER_COMMIT_NS = 50_000_000
LEAST_FREEZE_S = 1.5
LEAST_SILENT_S = 1.4  # as the Spine saw it; the last sign of life came just before the freeze
# How likely commits must be to have lost so many ticks by accident. With five of them, three must have had a loss where
# there is hardly any elsewhere; one stall of the machine, or two, that fall into their windows are no proof.
LEAST_CHANCE = 0.001


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
            "estimate": estimate,
            "rmse_deg": {name: rms(error_deg(part, joint)) for name, part in parts.items()},
            "freeze": freeze_of(joint, frozen, rest, sim),
        }
        for joint, (sim, estimate) in enumerate(zip(sims, story.estimates, strict=True))
    ]


def judge_swaps(
    records: npt.NDArray[Any], story: Story, made: losses.Releases, bounds_nm: npt.NDArray[np.float64]
) -> dict[str, Any]:
    """Each swap, and the ticks lost in the windows of all of them beside those lost in windows without one."""
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
    span = (int(records["release_ns"][0]), int(records["release_ns"][-1]) + 1)
    others = losses.elsewhere(span, whole, BEFORE_COMMIT_NS + AFTER_COMMIT_NS)
    told = losses.compare(made, handovers, others)
    return {
        "swaps": swaps,
        "swap_windows": losses.tally(made, whole),
        "commit_windows": losses.tally(made, handovers),
        "no_swap_windows": losses.tally(made, others),
        "swap_loss_chance": told.chance,
        "swap_loss_would_show": told.would_show(LEAST_CHANCE),
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
    records: npt.NDArray[Any], story: Story, sims: list[SimJoint], robot_info: Any, lost_records: int
) -> dict[str, Any]:
    """All of it. What stands beside `joints` is of the joints under gravity together, or of the worst of them."""
    rate_hz = float(robot_info["rate_hz"])
    made = losses.releases(records, round(1e9 / rate_hz))
    bounds_nm = np.asarray(robot_info["torque_slew_nm_s"][: len(sims)], dtype=np.float64) / rate_hz
    joints = judge_joints(records, story, sims)
    heavy = [joint for joint in joints if joint["bears_gravity"]]
    worst = max(heavy, key=lambda joint: float(np.nan_to_num(joint["mgl_error"], nan=np.inf)))
    return {
        "rate_hz": rate_hz,
        "joints": joints,
        "phases": judge_phases(records, story, [j for j, sim in enumerate(sims) if sim.bears_gravity]),
        **{key: worst[key] for key in ("mgl_true_nm", "mgl_hat_nm", "mgl_error", "estimate")},
        **judge_swaps(records, story, made, bounds_nm),
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


def _loss(tally: dict[str, Any]) -> str:
    return f"{tally['windows_with_loss']} of {tally['windows']} windows with a loss"


def verdict(summary: dict[str, Any]) -> list[str]:
    """What falls short, one sentence each; empty when the claim holds. A NaN never holds."""
    seen = {phase["name"] for phase in summary["phases"]}
    wrong = [f"phase '{name}' is missing" for name in PHASES if name not in seen]
    joints = summary["joints"]
    for joint in joints:
        wrong += shortcomings(joint, of_several=len(joints) > 1)
    freeze = summary["freeze"]
    if not freeze["duration_s"] >= LEAST_FREEZE_S:
        wrong.append(f"the Brain was frozen for {freeze['duration_s']:.2f} s, less than {LEAST_FREEZE_S} s")
    if not freeze["brain_silent_s"] >= LEAST_SILENT_S:
        wrong.append(f"the frozen Brain was silent for {freeze['brain_silent_s']:.2f} s only")
    if not summary["swaps"]:
        wrong.append("no law was swapped")
    for swap in summary["swaps"]:
        if not swap["output_step_nm"] <= swap["output_step_bound_nm"] + 1e-9:
            where = f" of joint '{joints[swap['output_step_joint']]['name']}'" if len(joints) > 1 else ""
            wrong.append(
                f"the swap to '{swap['law']}' stepped the torque{where} by {swap['output_step_nm']:.4f} N m, "
                f"the guard's bound is {swap['output_step_bound_nm']:.4f} N m"
            )
    if not summary["swap_loss_chance"] >= LEAST_CHANCE:
        wrong.append(
            f"swaps lose ticks: {_loss(summary['commit_windows'])} around a commit, "
            f"{_loss(summary['no_swap_windows'])} elsewhere (by accident: {summary['swap_loss_chance']:.1g})"
        )
    if summary["records_lost"] != 0:
        wrong.append(f"{summary['records_lost']} telemetry records were overwritten before they were read")
    return wrong
