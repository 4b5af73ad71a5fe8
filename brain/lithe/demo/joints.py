# SPDX-License-Identifier: Apache-2.0
"""The judge's knowledge and findings about each joint. The agent does not have them."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lithe.errors import LitheError
from lithe.files import read_regular, robot_table

from ..programs import binary
from .moves import MARGIN_RAD

MOST_MGL_ERROR = 0.05
# A 95 % interval misses one time in twenty by definition, so a miss alone refutes nothing: the claim falls short when
# the truth is beyond three times the interval, or where the interval is so wide that it says little. How often it holds
# is measured over 50 seeds (tests/system/agents/test_estimate.py).
MOST_INTERVALS = 3.0
MOST_HALF_WIDTH = 0.10
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
    mgl_nm: float  # as the robot file says it; from with_truth() on what the drive tells when it bears all of it
    most_share: float = 1.0  # of mgl, that it can come to bear where its limits leave room to hold a weight
    drive: dict[str, Any] = field(default_factory=dict, compare=False)  # of the robot file, with its defaults

    @property
    def bears_gravity(self) -> bool:
        return self.mgl_nm != 0


def most_share(position_min_rad: float, position_max_rad: float, soft_stop_rad: float) -> float:
    """The largest |sin| that a joint with these limits is asked to come to: as far off them as the agent keeps."""
    margin_rad = max(soft_stop_rad, MARGIN_RAD)
    least_rad, most_rad = position_min_rad + margin_rad, position_max_rad - margin_rad
    angles = np.clip([-np.pi / 2, np.pi / 2, least_rad, most_rad], least_rad, most_rad)
    return float(np.max(np.abs(np.sin(angles))))


def _refuse_hardware(robot_file: Path, config: dict[str, Any]) -> None:
    """LitheError when motors may hang on one of its buses. Whatever is not known to be simulated is real."""
    for bus in config.get("bus", []):
        if (kind := bus.get("kind")) != "loop":
            raise LitheError(
                f"{robot_file}: bus '{bus.get('name')}' is of kind \"{kind}\", so real motors may hang on it. The "
                "experiment drives every joint with laws that are bad on purpose, and freezes and kills its Brain. "
                'Nothing was started\n  next: simulate the bus (kind = "loop"); or, when devices are simulated at its '
                "far end, or all joints may swing freely and no person is near:\n"
                f"    python -m lithe.demo --robot {robot_file} --over-real-buses"
            )


def _joints(robot_file: Path, config: dict[str, Any]) -> list[SimJoint]:
    drives = {device["name"]: device for device in config.get("device", [])}
    soft_rad = float(config.get("guard", {}).get("soft_stop_rad", SOFT_STOP_RAD))
    joints = []
    for joint in config["joint"]:
        share = most_share(float(joint["position_min_rad"]), float(joint["position_max_rad"]), soft_rad)
        drive = drives.get(joint.get("device"), {})
        joints.append(SimJoint(str(joint["name"]), float(joint["sim"].get("mgl_nm", 0.0)), share, drive))
    return joints


def simulated_joints(robot_file: Path, over_real_buses: bool = False) -> list[SimJoint]:
    """The joints of a robot file on which the experiment may and can be done; asked before anything is started.

    LitheError when motors may hang on its buses and nobody allowed that, when none of its joints bears gravity, when
    what one of them bears depends on the others. Mistakes are for `lithe` to name.
    """
    try:
        config = robot_table(read_regular(robot_file))
        if not over_real_buses:
            _refuse_hardware(robot_file, config)
        if (plant := config.get("plant", {}).get("kind", "independent")) != "independent":
            raise LitheError(
                f'{robot_file} has [plant] kind = "{plant}": the experiment weighs each joint for itself; '
                'give it a robot whose joints swing each on its own ("independent")'
            )
        joints = _joints(robot_file, config)
    except OSError as error:
        raise LitheError(
            f"cannot read the robot file {robot_file}: {error.strerror}\n"
            "  next: give a .toml file, like those in robots/"
        ) from None
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise LitheError(
            f"{robot_file} is not what a robot file is ({type(error).__name__}: {error})\n"
            f"  next: `lithe bus plan {robot_file}` names its mistakes, and starts nothing"
        ) from None
    if not any(joint.bears_gravity for joint in joints):
        raise LitheError(f"{robot_file} simulates no gravity: give a joint's [joint.sim] an mgl_nm above 0")
    return joints


def with_truth(robot_file: Path, joints: list[SimJoint]) -> list[SimJoint]:
    """The same joints with the gravity torque that each really bears, in the torque that its drive tells.

    What the robot file only bounds (payload, error of the torque constant) its seed draws; `lithe sim --truth` tells.
    LitheError when a drive follows targets: the agent's laws give torques.
    """
    ran = subprocess.run(
        [binary("lithe-sim"), "--truth", robot_file], capture_output=True, text=True, check=False, timeout=60
    )
    if ran.returncode != 0:
        raise LitheError(ran.stderr.strip() or f"lithe-sim --truth {robot_file} ended with code {ran.returncode}")
    told = {one["name"]: one for one in json.loads(ran.stdout)["joints"]}
    for joint in joints:
        if told[joint.name]["closes_loop"]:
            raise LitheError(
                f"{robot_file}: device '{joint.drive.get('name')}' of joint '{joint.name}' has mode = "
                f'"{joint.drive.get("mode")}", in which a drive ignores the torques that the experiment\'s laws give\n'
                '  next: mode = "torque"'
            )
    return [replace(joint, mgl_nm=float(told[joint.name]["mgl_told_nm"])) for joint in joints]


def error_deg(records: npt.NDArray[Any], joint: int) -> npt.NDArray[np.float64]:
    """Setpoint minus position [deg]."""
    setpoint_rad, position_rad = (records[name][:, joint] for name in ("setpoint_position_rad", "position_rad"))
    error: npt.NDArray[np.float64] = np.degrees(setpoint_rad - position_rad)
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
        return abs(mgl_hat_nm - sim.mgl_nm) / abs(sim.mgl_nm)
    return 0.0 if mgl_hat_nm == 0 else 1.0


def interval_of(estimate: dict[str, Any], sim: SimJoint) -> dict[str, Any]:
    """The agent's interval [N m], its half width as a share of the estimate, and where the truth lies in it.

    `mgl_off_intervals` is the distance of the truth from the estimate in half widths: up to 1 the interval covers it.
    """
    least_nm, most_nm = (float(end) for end in estimate.get("mgl_interval_nm", (np.nan, np.nan)))
    half_nm, found_nm = (most_nm - least_nm) / 2, float(estimate["mgl_hat_nm"])
    share, off = np.nan, np.nan
    if half_nm > 0 and found_nm > 0:
        share, off = half_nm / found_nm, abs(sim.mgl_nm - found_nm) / half_nm
    return {"mgl_interval_nm": [least_nm, most_nm], "mgl_half_width": share, "mgl_off_intervals": off}


def shortcomings(joint: dict[str, Any], of_several: bool) -> list[str]:
    """What falls short with one joint of a summary. A NaN never holds."""
    name = f" (joint '{joint['name']}')" if of_several else ""
    if not joint["bears_gravity"]:
        believed = f"the agent believes that joint '{joint['name']}' bears gravity, which it does not"
        return [] if joint["mgl_error"] == 0 else [believed]
    wrong = []
    if not joint["mgl_error"] <= MOST_MGL_ERROR:
        wrong.append(f"mgl is off by {joint['mgl_error']:.1%}, more than {MOST_MGL_ERROR:.0%}{name}")
    if not joint["mgl_off_intervals"] <= MOST_INTERVALS:
        least_nm, most_nm = joint["mgl_interval_nm"]
        wrong.append(
            f"the true mgl of {joint['mgl_true_nm']:.4f} N m lies far outside the agent's interval "
            f"{least_nm:.4f} to {most_nm:.4f} N m{name}"
        )
    if not joint["mgl_half_width"] <= MOST_HALF_WIDTH:
        wrong.append(
            f"the agent's interval is +-{joint['mgl_half_width']:.1%} wide, more than {MOST_HALF_WIDTH:.0%}{name}"
        )
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
