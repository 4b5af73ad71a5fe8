# SPDX-License-Identifier: Apache-2.0
"""Learns a network on the simulated arm, by CMA-ES. Needs gymnasium and cma."""

import time
import warnings
from pathlib import Path

import numpy as np
from lithe import LitheError
from lithe.gym import FIELDS, SpineEnv
from network import Floats, Network

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # what it imports for figures
    try:
        import cma
    except ImportError:
        raise LitheError("cma is missing\n  next: pip install cma") from None

ARM = Path(__file__).resolve().parents[2] / "robots/arm.toml"
SEEDS = (1, 2, 3, 4)
STOPPED = 10.0  # rad^2 for each action that the guard did not let it take, or whose torque shakes the joint
BATCH = 16  # candidates


def cost(network: Network, envs: list[SpineEnv]) -> float:
    """Minus the mean reward of an action, over the same episodes for every network."""
    total = 0.0
    for env, seed in zip(envs, SEEDS, strict=True):
        seen, _ = env.reset(seed=seed)
        for action in range(100):
            seen, reward, terminated, truncated, info = env.step(network.share(*seen.reshape(len(FIELDS), -1)))
            total -= reward
            if terminated or info["shakes"]:
                total += STOPPED * (100 - action)
            if terminated or truncated or info["shakes"]:
                break
    return total / (100 * len(SEEDS))


def learn(candidates: int) -> tuple[Network, Floats]:
    """The best of so many networks, and the torque limits of the joints. Prints how far it is."""
    envs = [SpineEnv(ARM, rough=seed % 2 == 0) for seed in SEEDS]
    search = cma.CMAEvolutionStrategy(np.zeros(Network.SIZE), 0.3, {"seed": 1, "popsize": BATCH, "verbose": -9})
    while search.countevals < candidates:
        from_s = time.monotonic()
        weights = search.ask()
        search.tell(weights, [cost(Network(each), envs) for each in weights])
        left_s = (time.monotonic() - from_s) / BATCH * max(0, candidates - search.countevals)
        if search.countevals % (4 * BATCH) == 0 or search.countevals >= candidates:
            print(f"{search.countevals} of {candidates}: cost {search.best.f:.4f}, {left_s:.0f} s to go", flush=True)
    limits = envs[0].torque_max_nm
    for env in envs:
        env.close()
    return Network(np.asarray(search.result.xbest)), limits
