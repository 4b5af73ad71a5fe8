# SPDX-License-Identifier: Apache-2.0
"""Does an agent that never pauses disturb the Spine? `python -m bench.agent [--rounds N] [--block SECONDS]`

A robot follows a sine. In each round one block has an agent at the gateway, which reads, asks for history and checks
laws without pause, and one has none; which comes first is drawn. Told of both: release jitter from the Spine's own
histogram, and the shares of releases later than 1, 5, 20 and 100 us; their differences, and the ratio of the 99.9th
percentiles, with 95 % intervals over the rounds. The negative control runs another busy thread on the Spine's core.
Exit 0: no share grows by more than 0.1 %; 1: one does, or the rounds do not decide it. Prints one JSON line, and on
stderr ratio and verdict in words.
"""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from lithe.demo.processes import DIE_WITH_US, Stage, start_brain
from lithe.programs import ROOT
from lithe.remote import Remote

from bench.live import SETTLE_S, SINE, Bins, Probe, bin_top_us, control, quantile_us
from bench.swap.stats import permutation_interval

ROUNDS, BLOCK_S, PAUSE_S = 24, 3.0, 0.3
LIMITS_US = (1, 5, 20, 100)
MOST = 0.001  # a share of releases that grows by less is no effect
BATCH = 20  # requests between two looks at whether it should end


def agent(port: int, token: Path) -> None:
    """Asks until its stdin ends; a new law text each time, so that no cache answers. Prints how much it asked."""
    law = (ROOT / "laws/gravity_pd.cpp").read_text(encoding="utf-8")
    asked = 0
    with Remote("127.0.0.1", port, token) as remote:
        print("ready", flush=True)
        for line in sys.stdin:
            until_s = time.monotonic() + float(line)
            while time.monotonic() < until_s:
                for verb, args in (("latest", {}), ("status", {}), ("history", {"seconds": 1.0}), ("describe", {})):
                    remote.call(verb, **args)
                asked += 4
                if asked % BATCH == 0:
                    remote.call("law_check", source=f"{law}\n// {asked} {time.monotonic_ns()}\n")
                    asked += 1
            print(asked, flush=True)


def later_than(bins: Bins, limit_us: float) -> float:
    """Share of releases later than that, to a bin's edge."""
    tops = np.array([bin_top_us(i) for i in range(len(bins))])
    return float(bins[tops > limit_us].sum() / max(int(bins.sum()), 1))


def ratio_interval(busy: list[Bins], quiet: list[Bins]) -> list[float | None]:
    """Low, middle and high of the ratio of the 99.9th percentiles of lateness, with the agent over without it, round by
    round. None: too few rounds to tell.
    """
    late_us = [np.array([max(quantile_us(bins, 0.999), 1e-3) for bins in side]) for side in (busy, quiet)]
    logs = np.log(late_us[0] / late_us[1])
    low, high = permutation_interval(logs)
    return [float(np.exp(each)) if np.isfinite(each) else None for each in (low, logs.mean(), high)]


def block(probe: Probe, seconds: float) -> Bins:
    """The releases of this time."""
    probe.start()
    probe.wait(seconds)
    bins: Bins = probe.stage.spine.histogram("release_jitter") - probe.jitter
    return bins


def requests_per_s(requests: int, rounds: int, block_s: float) -> float:
    """In each round the agent asks during the block, and half of PAUSE_S before and after it."""
    return requests / (rounds * (block_s + PAUSE_S))


def measure(asked: argparse.Namespace) -> dict[str, Any]:
    """All figures."""
    order = random.Random(1)
    busy: list[Bins] = []
    quiet: list[Bins] = []
    with tempfile.TemporaryDirectory() as name, Stage(ROOT / "robots/arm.toml", Path(name) / "run.log") as stage:
        token = Path(name) / "token"
        _, port = start_brain(stage, token, SINE)
        words = [*DIE_WITH_US, sys.executable, "-m", "bench.agent", "--agent", str(port), str(token)]
        pipe = subprocess.PIPE
        with subprocess.Popen(words, stdin=pipe, stdout=pipe, text=True, cwd=ROOT) as child:
            assert child.stdin is not None and child.stdout is not None
            child.stdout.readline()
            time.sleep(SETTLE_S)
            probe, requests = Probe(stage), 0
            for number in range(asked.rounds):
                for with_agent in order.sample((True, False), 2):
                    if with_agent:
                        child.stdin.write(f"{asked.block + PAUSE_S}\n")
                        child.stdin.flush()
                    time.sleep(PAUSE_S / 2)
                    (busy if with_agent else quiet).append(block(probe, asked.block))
                    if with_agent:
                        requests = int(child.stdout.readline())
                print(f"bench: round {number + 1} of {asked.rounds}", end="\r", file=sys.stderr)
            child.stdin.close()
        told = control(probe)
    both = {"busy": np.sum(busy, axis=0), "quiet": np.sum(quiet, axis=0)}
    out: dict[str, Any] = {"agent_requests_per_s": requests_per_s(requests, asked.rounds, asked.block)}
    for key, bins in both.items():
        out |= {f"agent_{key}_p50_us": quantile_us(bins, 0.5), f"agent_{key}_p99_us": quantile_us(bins, 0.99),
                f"agent_{key}_p999_us": quantile_us(bins, 0.999), f"agent_{key}_max_us": quantile_us(bins, 1.0),
                f"agent_{key}_releases": int(bins.sum())}  # fmt: skip
    worst = -1.0
    for limit in LIMITS_US:
        shares = [np.array([later_than(bins, limit) for bins in side]) for side in (busy, quiet)]
        low, high = permutation_interval(shares[0] - shares[1])
        mean = float(np.mean(shares[0] - shares[1]))
        out[f"agent_later_{limit}us_busy"], out[f"agent_later_{limit}us_quiet"] = (
            float(side.mean()) for side in shares
        )
        out[f"agent_later_{limit}us_difference"] = [low, mean, high]
        worst = max(worst, high)
    out["agent_ratio_p999"] = ratio_interval(busy, quiet)
    failed = told["run_control_p999_us"] > 3 * max(out["agent_quiet_p999_us"], 1.0)
    out |= {"agent_control_p999_us": told["run_control_p999_us"], "agent_control_failed_as_it_must": failed}
    grows = any(out[f"agent_later_{limit}us_difference"][0] > 0 and
                out[f"agent_later_{limit}us_difference"][1] > MOST for limit in LIMITS_US)  # fmt: skip
    out["verdict"] = (
        "INCONCLUSIVE" if not failed else "falls short" if grows else "holds" if worst <= MOST else "INCONCLUSIVE"
    )
    return out


def main(words: list[str]) -> int:
    """Measure and print the line."""
    parser = argparse.ArgumentParser(prog="python -m bench.agent", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--block", type=float, default=BLOCK_S, help="seconds")
    parser.add_argument("--agent", nargs=2, metavar=("PORT", "TOKEN"), help=argparse.SUPPRESS)
    asked = parser.parse_args(words)
    if asked.agent:
        agent(int(asked.agent[0]), Path(asked.agent[1]))
        return 0
    told = measure(asked)
    low, middle, high = ("?" if each is None else f"{each:.3f}" for each in told["agent_ratio_p999"])
    print(f"99.9th percentile with the agent over without: {middle}, 95 %: {low} to {high}; {told['verdict']}",
          file=sys.stderr)  # fmt: skip
    print(json.dumps(told))
    return 0 if told["verdict"] == "holds" else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
