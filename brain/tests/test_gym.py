# SPDX-License-Identifier: Apache-2.0
"""The Gymnasium environment, on the program that tries laws."""

import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from calm import changed
from gymnasium.utils.env_checker import check_env
from lithe import LitheError
from lithe.gym import FIELDS, Floats, SpineEnv
from system.robot_rig import BIN, ROOT, need

ARM, CHAIN = ROOT / "robots/arm.toml", ROOT / "robots/chain.toml"
LOOP = 'kind = "loop"'


@pytest.fixture(autouse=True)
def programs(monkeypatch: pytest.MonkeyPatch) -> None:
    need("lithe-trial")
    monkeypatch.setenv("LITHE_BIN_DIR", str(BIN))


@pytest.fixture
def arm(programs: None) -> Iterator[SpineEnv]:
    env = SpineEnv(ARM)
    yield env
    env.close()


def part(observation: Floats, field: str) -> Floats:
    return observation.reshape(len(FIELDS), -1)[FIELDS.index(field)]


def pd(env: SpineEnv, observation: Floats) -> Floats:
    """A PD law's torques as an action."""
    error = part(observation, "setpoint_position_rad") - part(observation, "position_rad")
    slower = part(observation, "setpoint_velocity_rad_s") - part(observation, "velocity_rad_s")
    return (4 * error + 0.1 * slower) / env.torque_max_nm


@pytest.mark.parametrize("robot", [ARM, CHAIN], ids=["arm", "chain"])
def test_gymnasiums_own_check_passes(robot: Path) -> None:
    env = SpineEnv(robot)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*Box observation space (minimum|maximum) value is -?infinity")
        check_env(env, skip_render_check=True)
    env.close()


def rollout(seed: int, rough: bool) -> tuple[bytes, int]:
    """All bits of two episodes with random actions, and the ticks of the second."""
    env, actions, told = SpineEnv(CHAIN, rough=rough), np.random.default_rng(5), b""
    for episode in range(2):
        observation, info = env.reset(seed=seed if episode == 0 else None)
        told += observation.tobytes()
        over = False
        while not over:
            observation, reward, terminated, truncated, info = env.step(actions.uniform(-0.2, 0.2, len(env.joints)))
            told += observation.tobytes() + np.float64(reward).tobytes() + info["command_torque_nm"].tobytes()
            over = terminated or truncated
    env.close()
    return told, int(info["tick"])


@pytest.mark.parametrize("rough", [False, True])
def test_the_same_seed_and_actions_give_the_same_bits(rough: bool) -> None:
    first = rollout(3, rough)
    assert rollout(3, rough) == first
    assert rollout(4, rough) != first


def test_an_episode_is_truncated_at_its_end_and_a_law_that_tracks_is_rewarded(arm: SpineEnv) -> None:
    returns = {}
    for name in ("pd", "nothing"):
        observation, info = arm.reset(seed=2)
        returns[name], steps, truncated = 0.0, 0, False
        while not truncated:
            action = pd(arm, observation) if name == "pd" else np.zeros(1)
            observation, reward, terminated, truncated, info = arm.step(action)
            assert not terminated
            returns[name] += reward
            steps += 1
        assert steps == 100 and info["tick"] == 1000
    assert 0 > returns["pd"] > 0.1 * returns["nothing"]
    with pytest.raises(LitheError, match="the episode is over: reset first"):
        arm.step(np.zeros(1))


def raised(tmp_path: Path, changes: dict[str, str]) -> Path:
    """An arm that starts raised, must not fall far, and is too heavy for its motor."""
    path = tmp_path / "raised.toml"
    own = {
        'law = "../laws/pd.cpp"': "",
        "initial_position_rad = 0.0": "initial_position_rad = 1.5",
        "position_min_rad = -3.0 ": "position_min_rad = 0.9 ",
        "mgl_nm = 0.165": "mgl_nm = 1.2",  # more than its motor can hold
        **changes,
    }
    path.write_text(changed(ARM.read_text(encoding="utf-8"), own, "robots/arm.toml"), encoding="utf-8")
    return path


def test_the_guards_stop_terminates_an_episode_and_says_why(tmp_path: Path) -> None:
    env = SpineEnv(raised(tmp_path, {}))
    env.reset(seed=1)
    terminated = truncated = False
    while not terminated and not truncated:
        *_, terminated, truncated, info = env.step(np.zeros(1))
    assert terminated and not truncated and "position_limit: joint shoulder" in info["ended"]
    env.close()


def test_the_guard_clamps_what_a_policy_asks_too_much(arm: SpineEnv) -> None:
    arm.reset(seed=1)
    *_, info = arm.step(np.array([0.05]))
    assert not info["clamped"] and info["command_torque_nm"] == pytest.approx(0.03)
    *_, info = arm.step(np.array([3.0]))
    assert info["clamped"] and info["command_torque_nm"] <= arm.torque_max_nm


def test_bad_input_is_named_with_the_next_step(arm: SpineEnv, tmp_path: Path) -> None:
    with pytest.raises(LitheError, match="no episode has begun: reset first"):
        arm.step(np.zeros(1))
    arm.reset(seed=1)
    with pytest.raises(LitheError, match=r"shape \(2,\), not \(1,\)\n  next: .*shoulder"):
        arm.step(np.zeros(2))
    with pytest.raises(LitheError, match="joint shoulder is not finite\n  next: "):
        arm.step(np.array([np.nan]))
    arm.step(np.zeros(1))
    with pytest.raises(LitheError, match="nowhere.toml"):
        SpineEnv(tmp_path / "nowhere.toml")
    with pytest.raises(LitheError, match="bus can0 is a real one.*copy the file"):
        SpineEnv(raised(tmp_path, {LOOP: 'kind = "socketcan"\ninterface = "can0"'}))
    bad = SpineEnv(ARM, ticks_per_action=0)
    with pytest.raises(LitheError, match='"ticks" must be a number from 1'):
        bad.reset(seed=1)
    bad.close()
    bad.close()
    with pytest.raises(LitheError, match="closed"):
        bad.reset(seed=1)


def test_without_gymnasium_the_way_to_it_is_told() -> None:
    code = "import sys; sys.modules['gymnasium'] = None; import lithe; import lithe.gym"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT / "brain", capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 1 and "gymnasium is missing\n  next: pip install gymnasium" in done.stderr
