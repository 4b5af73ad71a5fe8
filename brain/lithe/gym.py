# SPDX-License-Identifier: Apache-2.0
"""A Gymnasium environment of a robot file: the simulated robot, its control step and its guard, without a clock.

    from lithe.gym import SpineEnv
    env = SpineEnv("robots/arm.toml")
    observation, info = env.reset(seed=1)

The program behind it is `lithe-trial`, with the closed loop in which the trial of a swap runs a law.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

from .errors import LitheError
from .programs import binary

try:
    import gymnasium
except ImportError:
    raise LitheError("gymnasium is missing\n  next: pip install gymnasium") from None
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
FIELDS = (
    "position_rad", "velocity_rad_s", "setpoint_position_rad", "setpoint_velocity_rad_s", "setpoint_acceleration_rad_s2"
)  # fmt: skip


class SpineEnv(gymnasium.Env[Floats, Floats]):
    """Track the setpoint of each joint of a robot file whose buses are all simulated.

    Action, shape (joints,): the torque as a share of the joint's torque_max_nm, from -1 to 1, held for
    `ticks_per_action` ticks. The guard limits it as it limits a law.

    Observation, shape (5 * joints,): what a law sees in lithe::Tick, joint by joint in each part: position [rad],
    velocity [rad/s], setpoint's position [rad], velocity [rad/s] and acceleration [rad/s^2]. It is of the last tick
    that ran: an action takes effect one tick later than the torque of a law that sees the same.

    Reward: minus the mean of the joints' squared tracking errors [rad^2], minus `torque_weight` [rad^2] times the mean
    of their squared torques after the guard, as shares of torque_max_nm.

    An episode lasts `seconds` of the robot's time (truncated); the guard may stop the robot before (terminated,
    info["ended"] says why). In it the setpoints lead each joint to a distance and back, as in a trial; how far, the
    seed decides. `rough`: 20 % heavier, with noise, a push, and everything one tick later, as in a trial's second run.
    The same seed and actions give the same bits.

    info: tick; clamped (the guard changed a torque since the last action); shakes ("" or which joint does: the trial
    refuses such a law); ended; command_torque_nm, after the guard.
    """

    def __init__(
        self,
        robot: str | Path,
        *,
        rough: bool = False,
        ticks_per_action: int = 10,
        seconds: float = 1.0,
        torque_weight: float = 1e-3,
    ) -> None:
        """Starts the simulation. LitheError when the robot file cannot be read or has a real bus."""
        command = [binary("lithe-trial"), robot, "--steps"]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        about = self._ask(verb="describe")
        self.joints = [str(joint["name"]) for joint in about["joints"]]
        self.torque_max_nm = np.array([joint["torque_max_nm"] for joint in about["joints"]], dtype=np.float64)
        self.rate_hz = float(about["rate_hz"])
        self._episode = {"rough": rough, "ticks": ticks_per_action, "seconds": seconds}
        self._torque_weight = torque_weight
        count = len(self.joints)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (count,), np.float64)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (len(FIELDS) * count,), np.float64)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Begins an episode, and runs its first tick without torque. Without a seed, the next of the last seed's."""
        super().reset(seed=seed)
        answer = self._ask(verb="reset", seed=int(self.np_random.integers(1, 1 << 53)), **self._episode)
        return self._observation(answer), self._info(answer)

    def step(self, action: npt.ArrayLike) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """One action. LitheError when it has another shape, or a value that is no number, or no episode has begun."""
        share = np.asarray(action, dtype=np.float64)
        if share.shape != self.action_space.shape:
            raise LitheError(
                f"the action has shape {share.shape}, not {self.action_space.shape}\n"
                f"  next: give one share of the largest torque per joint: {', '.join(self.joints)}"
            )
        if not np.isfinite(share).all():
            joint = self.joints[int(np.argmin(np.isfinite(share)))]
            raise LitheError(
                f"the action of joint {joint} is not finite\n  next: look for a division by 0, or a diverged policy"
            )
        answer = self._ask(verb="step", torque_nm=(share * self.torque_max_nm).tolist())
        observation, info = self._observation(answer), self._info(answer)
        position_rad, _, setpoint_rad, *_ = observation.reshape(len(FIELDS), -1)
        error_rad, used = setpoint_rad - position_rad, info["command_torque_nm"] / self.torque_max_nm
        reward = -float(error_rad @ error_rad + self._torque_weight * (used @ used)) / len(self.joints)
        terminated = bool(info["ended"])
        return observation, reward, terminated, bool(answer["over"]) and not terminated, info

    def close(self) -> None:
        """Ends the simulation; may be called twice."""
        if self._process.returncode is None:
            self._process.communicate()

    def _observation(self, answer: dict[str, Any]) -> Floats:
        return np.array([answer[field] for field in FIELDS], dtype=np.float64).ravel()

    def _info(self, answer: dict[str, Any]) -> dict[str, Any]:
        info = {key: answer[key] for key in ("tick", "clamped", "shakes", "ended")}
        return {**info, "command_torque_nm": np.array(answer["command_torque_nm"], dtype=np.float64)}

    def _ask(self, **request: Any) -> dict[str, Any]:
        if self._process.returncode is not None:
            raise LitheError("this environment is closed\n  next: make another one")
        assert self._process.stdin is not None and self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
            answer: dict[str, Any] = json.loads(self._process.stdout.readline())
        except (OSError, ValueError):
            said = self._process.communicate()[1].strip()
            raise LitheError(said or "lithe-trial has ended\n  next: make another environment") from None
        if not answer["ok"]:
            raise LitheError(str(answer["reason"]))
        return answer
