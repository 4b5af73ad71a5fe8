# SPDX-License-Identifier: Apache-2.0
"""What the judge knows of each joint, and what it says of each. The agent knows none of it."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lithe.errors import LitheError

MOST_MGL_ERROR = 0.05
MOST_EVOLVED_DEG = 3.0
LEAST_IMPROVEMENT = 8.0
MOST_EXCURSION_DEG = 5.0
LEAST_GRAVITY_SHARE = 0.9
REST_S = 0.7
SOFT_STOP_RAD = 0.1  # of the guard, where a robot file says nothing


@dataclass(frozen=True)
class SimJoint:
    """A joint as the simulation was told it."""

    name: str
    mgl_nm: float
    most_share: float = 1.0  # of mgl, that it can come to bear where the guard lets it hold a weight

    @property
    def bears_gravity(self) -> bool:
        return self.mgl_nm > 0


def _most_share(least_rad: float, most_rad: float) -> float:
    """The largest |sin| between two angles."""
    angles = np.clip([-np.pi / 2, np.pi / 2, least_rad, most_rad], least_rad, most_rad)
    return float(np.max(np.abs(np.sin(angles))))


def simulated_joints(robot_file: Path) -> list[SimJoint]:
    """The joints of a robot file in which `lithe run` has found no fault. LitheError when none bears gravity."""
    config = tomllib.loads(robot_file.read_text(encoding="utf-8"))
    common = config.get("defaults", {}).get("joint", {})
    soft_rad = float(config.get("guard", {}).get("soft_stop_rad", SOFT_STOP_RAD))
    joints = []
    for own in config["joint"]:
        joint = {**common, **own}
        sim = {**common.get("sim", {}), **own.get("sim", {})}
        share = _most_share(float(joint["position_min_rad"]) + soft_rad, float(joint["position_max_rad"]) - soft_rad)
        joints.append(SimJoint(str(joint["name"]), float(sim.get("mgl_nm", 0.0)), share))
    if not any(joint.bears_gravity for joint in joints):
        raise LitheError(f"{robot_file} simulates no gravity: give a joint's [joint.sim] an mgl_nm above 0")
    return joints


def error_deg(records: npt.NDArray[Any], joint: int) -> npt.NDArray[np.float64]:
    """Setpoint minus position [deg]."""
    error: npt.NDArray[np.float64] = np.degrees(
        records["setpoint_position_rad"][:, joint] - records["position_rad"][:, joint]
    )
    return error


def rms(values: npt.NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def freeze_of(joint: int, frozen: npt.NDArray[Any], rest: npt.NDArray[Any], sim: SimJoint) -> dict[str, float]:
    """How a joint held without its Brain: all of the freeze, and its end, when the setpoint has coasted to a stop."""
    angles = rest["position_rad"][:, joint]
    last_rad = float(angles[-1]) if len(angles) else float("nan")
    return {
        "max_excursion_deg": float(np.max(np.abs(error_deg(frozen, joint)))) if len(frozen) else float("nan"),
        "rest_angle_deg": float(np.degrees(last_rad)),
        "rest_sag_deg": float(np.degrees(np.ptp(angles))) if len(angles) else float("nan"),
        "gravity_share": float(abs(np.sin(last_rad)) / sim.most_share),
    }


def mgl_error(mgl_hat_nm: float, sim: SimJoint) -> float:
    """Relative; of a joint that bears nothing: 0, or 1 when the agent believes that it does."""
    if sim.bears_gravity:
        return abs(mgl_hat_nm - sim.mgl_nm) / sim.mgl_nm
    return 0.0 if mgl_hat_nm == 0 else 1.0


def shortcomings(joint: dict[str, Any], of_several: bool) -> list[str]:
    """What falls short with one joint of a summary. A NaN never holds."""
    name = f" (joint '{joint['name']}')" if of_several else ""
    if not joint["bears_gravity"]:
        believed = f"the agent believes that joint '{joint['name']}' bears gravity, which it does not"
        return [] if joint["mgl_error"] == 0 else [believed]
    wrong = []
    if not joint["mgl_error"] <= MOST_MGL_ERROR:
        wrong.append(f"mgl is off by {joint['mgl_error']:.1%}, more than {MOST_MGL_ERROR:.0%}{name}")
    rmse = joint["rmse_deg"]
    baseline_deg = rmse.get("baseline", np.nan)
    for phase in ("evolved", "resumed", "reattached"):
        here_deg = rmse.get(phase, np.nan)
        if not (here_deg <= MOST_EVOLVED_DEG and here_deg * LEAST_IMPROVEMENT <= baseline_deg):
            wrong.append(f"RMSE {phase} {here_deg:.2f} deg, baseline {baseline_deg:.1f} deg{name}")
    if not rmse.get("gravity_only", 0.0) >= 0:
        wrong.append(f"RMSE gravity_only was not measured{name}")
    freeze = joint["freeze"]
    if not freeze["max_excursion_deg"] <= MOST_EXCURSION_DEG:
        wrong.append(f"the frozen arm moved {freeze['max_excursion_deg']:.1f} deg off its setpoint{name}")
    if not freeze["gravity_share"] > LEAST_GRAVITY_SHARE:
        wrong.append(f"the frozen arm bore {freeze['gravity_share']:.0%} of the largest gravity torque only{name}")
    return wrong
