# SPDX-License-Identifier: Apache-2.0
"""The agent: a process that reaches the robot only over TCP, and improves its control law.

Deterministic and offline: it measures, estimates, writes C++ and asks for swaps. Nothing about the plant is built in;
it knows what the gateway tells (rate, joints, limits) and that an angle of 0 hangs straight down. Which joints bear
gravity, how heavy they are and how late their drives obey it finds out by itself. What it does goes to stdout as JSON
lines.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lithe.agent import options, report
from lithe.agent.link import Link, columns_of, motions_of
from lithe.agent.reference import Asked, Streamer, reference_of
from lithe.agent.rounds import Limits, Rounds
from lithe.errors import LitheError
from lithe.identify import Arm, Motion, identify_arm, identify_joint, mgl_at_rest, torque_lag_s
from lithe.remote import Remote

from . import moves, sources
from .sources import Gains

BAD_ON_PURPOSE = {"probation_s": 0.0}  # no law before it tracked worse, and it shall run all the same
# Badly tuned on purpose: the experiment starts from a bad law. Per N m of a joint's largest torque.
WEAK = Gains(1 / 12, 1 / 150)
FOLLOWING = 4.0  # times as strong: what a joint that is not probed by torques follows the sine with meanwhile
FIELDS = ["tick", "sample_ns", "position_rad", "velocity_rad_s", "torque_nm", "command_torque_nm"]

KEPT_TICKS = 4096  # of telemetry, by the gateway's `history`
REST_S = 0.3  # a probe has ended when the joints have rested so long
# How fast a joint may be made. The drives' own filters take their share beyond 60 rad/s at any tick rate; a twentieth
# of the tick rate leaves room for one tick of delay, and what was measured of a slow bus or drive counts in full.
MOST_BANDWIDTH_RAD_S = 60.0
LAG_RAD = 0.2  # of phase, that the whole way from a torque commanded to one measured may cost at the bandwidth
SLOW_COMPUTER_S = 600.0  # for one answer: on an emulated board a swap had none within 60 s
DAMPING = 1.8  # twice the damping ratio


def tell(**what: Any) -> None:
    """Prints one line of JSON."""
    print(json.dumps(what), flush=True)


def as_motions(pieces: list[dict[str, Any]]) -> list[Motion]:
    """Answers of the gateway's verb `history`, one after the other, as the motion of each joint."""
    return motions_of(columns_of(pieces, FIELDS))


def last(motion: Motion, seconds: float) -> npt.NDArray[np.bool_]:
    """Which samples belong to the last `seconds`."""
    chosen: npt.NDArray[np.bool_] = motion.t_s > motion.t_s[-1] - seconds
    return chosen


def rests(motion: Motion) -> bool:
    """True when the joint has moved less than a tenth of a degree in the last 0.3 s.

    Means of pieces are compared: single readings of an encoder differ by its noise.
    """
    pieces = np.array_split(motion.position_rad[last(motion, REST_S)], 6)
    return bool(np.ptp([np.mean(piece) for piece in pieces if len(piece)]) < np.radians(0.1))


class Agent:
    def __init__(self, remote: Remote) -> None:
        self.remote = remote
        about = remote.call("describe")
        self.rate_hz = float(about["rate_hz"])
        self.joints: list[dict[str, Any]] = about["joints"]
        self.names = [str(joint["name"]) for joint in self.joints]
        self.torque_max_nm = [float(joint["torque_max_nm"]) for joint in self.joints]
        self.weak = [WEAK.times(most_nm) for most_nm in self.torque_max_nm]
        self.lag_s = [0.0 for _ in self.joints]
        self.source = ""  # of the newest law

    def swap(self, name: str, source: str, **terms: float) -> None:
        tell(doing=f"asks for a swap to {name}")
        sent_ns = time.monotonic_ns()
        record = self.remote.call("swap", source=source, name=f"{name}.cpp", brief=False, **terms)
        tell(swap={"law": name, "sent_ns": sent_ns, **record})
        self.source = source

    def track(self) -> None:
        """Every joint follows its sine, once it has faded in."""
        sines = moves.sines(self.joints)
        answer = self.remote.call("set_reference", stay=True, **sines)
        tell(reference={**sines, "since_ns": answer["since_ns"]})
        time.sleep(moves.RAMP_S)

    def tick(self) -> int:
        return int(self.remote.call("latest", fields=["tick"])["tick"])

    def record(
        self, since: int, seconds: float, resting: list[int] | None = None, rest_by_s: float = 0.0
    ) -> list[dict[str, Any]]:
        """Telemetry from that tick to `seconds` from now, and on until all of `resting` rest or `rest_by_s` are over.

        Gathered piece by piece, four times in what the Brain keeps.
        """
        pause_s = min(1.0, KEPT_TICKS / self.rate_hz / 4)
        pieces: list[dict[str, Any]] = []
        start = time.monotonic()
        while (left := start + seconds - time.monotonic()) > 0 or not pieces:
            time.sleep(min(pause_s, max(left, 0.1)))
            piece = self.remote.call("history", seconds=4.0, since_tick=since, fields=FIELDS)
            if piece["tick"]:
                since = piece["tick"][-1]
                pieces.append(piece)
                if left <= pause_s and time.monotonic() < start + rest_by_s:
                    motions = as_motions(pieces)
                    seconds += 0.0 if all(rests(motions[joint]) for joint in resting or []) else 0.5
        return pieces

    def rest(self, most_s: float = 2.0) -> None:
        """Until the setpoint rests where the robot does."""
        self.remote.call("set_reference", kind="rest", stay=True)  # from now on the setpoint waits for the robot
        until = time.monotonic() + most_s
        while time.monotonic() < until:
            time.sleep(0.1)
            motions = as_motions([self.remote.call("history", seconds=REST_S + 0.1, fields=FIELDS)])
            if motions[0].t_s[-1] > REST_S and all(map(rests, motions)):
                break
        self.remote.call("set_reference", kind="rest", stay=True)
        self.wait_for_setpoint(most_s)

    def wait_for_setpoint(self, most_s: float) -> None:
        """Until the setpoint has come to the robot, within half a degree."""
        until = time.monotonic() + most_s
        while time.monotonic() < until:
            now = self.remote.call("latest", fields=["setpoint_position_rad", "position_rad"])
            if np.max(np.abs(np.subtract(*now.values()))) < np.radians(0.5):
                return
            time.sleep(0.05)

    def phase(self, name: str) -> None:
        tell(phase=name, from_ns=time.monotonic_ns())

    def named(self, joint: int, values: str) -> str:
        """With the joint's name, on a robot where that tells anything."""
        return values if len(self.names) == 1 else f"{self.names[joint]} {values}"

    # ---- the protocol
    def baseline(self) -> list[dict[str, Any]]:
        when = time.strftime("%Y-%m-%d %H:%M:%S")
        self.swap("detuned_pd", sources.baseline(self.names, self.weak, when), **BAD_ON_PURPOSE)
        self.track()
        self.phase("baseline")
        return self.record(self.tick(), 6.0)

    def choose_probes(self, baseline: list[dict[str, Any]]) -> list[tuple[float, float] | None]:
        """For each joint the two probe torques, from the motion under the first law.

        None when no gravity is visible, or the limits leave no room: such a joint follows the sine.
        """
        chosen: list[tuple[float, float] | None] = []
        heavy = []
        for number, motion in enumerate(as_motions(baseline)):
            try:
                rough = identify_joint([motion])
            except ValueError:  # it has hardly moved
                rough = None
            shares = None
            if rough is not None and rough.mgl_nm > 0:
                heavy.append(self.named(number, f"{rough.mgl_nm:.2f} N m"))
                shares = moves.probe_shares(rough, motion, self.joints[number])
            most_nm = 0.0 if rough is None else min(rough.mgl_nm, self.torque_max_nm[number])
            chosen.append(None if shares is None else (shares[0] * most_nm, shares[1] * most_nm))
        tell(doing=f"reads gravity from the baseline: about {', '.join(heavy)}" if heavy else "sees no gravity yet")
        return chosen

    def probe(self, baseline: list[dict[str, Any]]) -> list[Arm]:
        """Two constant torques; all motion is used, the swings above all, and the rests alone for comparison."""
        chosen = self.choose_probes(baseline)
        self.phase("probing")
        probed = [joint for joint, torques in enumerate(chosen) if torques is not None]
        following = [gains.times(FOLLOWING) for gains in self.weak]
        runs = []
        for number in (1, 2):
            torques_nm = [None if torques is None else torques[number - 1] for torques in chosen]
            source = sources.probe(number, self.names, torques_nm, following)
            since = self.tick()  # where the machine is busy, the swing is half over before the swap has been answered
            self.swap(f"probe_{number}", source, **BAD_ON_PURPOSE)
            runs.append(self.record(since, 2.5, probed, rest_by_s=8.0))
        before, *motions = [as_motions(run) for run in (baseline, *runs)]
        arms = []
        for joint, name in enumerate(self.names):
            self.lag_s[joint] = self.lag_of(joint, [baseline, *runs])
            of_joint = [motion[joint] for motion in motions]
            try:
                identify = identify_arm if joint in probed else identify_joint
                arm = identify([before[joint], *of_joint])
            except ValueError as error:
                raise ValueError(f"joint '{name}': {error}") from None
            arms.append(arm)
            resting = at_rest(arm, of_joint, name) if joint in probed else {}
            tell(estimate={"name": name, **self.estimate(joint, arm), **resting})
        return arms

    @staticmethod
    def lag_of(joint: int, runs: list[list[dict[str, Any]]]) -> float:
        records = []
        for columns in (columns_of(run, FIELDS) for run in runs):
            t_s = (columns["sample_ns"] - columns["sample_ns"][0]) * 1e-9
            records.append((t_s, columns["command_torque_nm"][:, joint], columns["torque_nm"][:, joint]))
        return torque_lag_s(records)

    def estimate(self, joint: int, arm: Arm) -> dict[str, Any]:
        return {
            "mgl_hat_nm": arm.mgl_nm,
            "mgl_se_nm": arm.mgl_se_nm,
            "mgl_interval_nm": list(arm.mgl_interval_nm),
            "inertia_hat_kg_m2": arm.inertia_kg_m2,
            "coulomb_hat_nm": arm.coulomb_nm,
            "viscous_hat_nm_s_rad": arm.viscous_nm_s_rad,
            "windows": arm.windows,
            "lag_s": self.lag_s[joint],
            "bandwidth_rad_s": self.bandwidth_rad_s(joint),
        }

    def bandwidth_rad_s(self, joint: int) -> float:
        """The bandwidth that tick rate, bus and drive of this joint allow."""
        lag_s = self.lag_s[joint]
        slowed_rad_s = LAG_RAD / lag_s if lag_s > 0 else np.inf
        return float(min(self.rate_hz / 20.0, MOST_BANDWIDTH_RAD_S, slowed_rad_s))

    def gravity_only(self, arms: list[Arm]) -> None:
        """An ablation: one period of the sine with the gravity term added to the gains of the baseline."""
        tell(phase="", from_ns=time.monotonic_ns())
        gravity = [replace(arm, inertia_kg_m2=0.0, coulomb_nm=0.0) for arm in arms]
        self.rest()
        source = sources.model("gravity_only", sources.GRAVITY_ONLY, self.names, gravity, self.weak)
        self.swap("gravity_only", source, **BAD_ON_PURPOSE)
        self.track()
        self.phase("gravity_only")
        time.sleep(1 / moves.FREQUENCY_HZ)

    def evolve(self, arms: list[Arm]) -> None:
        self.phase("evolving")
        omegas = [self.bandwidth_rad_s(joint) for joint in range(len(arms))]
        gains = [
            Gains(arm.inertia_kg_m2 * omega**2, DAMPING * omega * arm.inertia_kg_m2)
            for arm, omega in zip(arms, omegas, strict=True)
        ]
        source = sources.model("evolved", sources.EVOLVED, self.names, arms, gains)
        tell(source=source)
        self.rest()  # so that the new law starts without an error
        self.swap("evolved", source)
        self.show_evolved()

    def show_evolved(self) -> None:
        """The last law follows the sine, for as long as the first one did."""
        self.track()
        time.sleep(0.5)
        self.phase("evolved")
        time.sleep(6.0)


class ModelAgent(Agent):
    """The same measurements; then a language model writes the laws, round after round (lithe.agent)."""

    def __init__(self, remote: Remote, args: argparse.Namespace) -> None:
        super().__init__(remote)
        self.args = args
        self.sent_ns = 0

    def evolve(self, arms: list[Arm]) -> None:
        self.phase("evolving")
        transcript = options.new_transcript(self.args.out)

        def say(kind: str, /, **what: Any) -> None:
            transcript.add(kind, **what)
            if kind == "swap":
                self.sent_ns = time.monotonic_ns()
            elif kind == "committed":
                tell(swap={"sent_ns": self.sent_ns, **what["certificate"]})
            elif kind == "generation":
                rms_deg = what["measured"]["rms_deg"] if what["measured"] else "not measured"
                tell(doing=f"tried generation {what['number']}: {what['verdict']}, RMSE [deg] {rms_deg}")

        link = Link(self.remote, say)
        limits = Limits(self.args.rounds, self.args.swaps, self.args.failures, 1 / moves.FREQUENCY_HZ, 1.0)
        goal = f"track {moves.FREQUENCY_HZ} Hz with the least error"
        model = options.model_of(self.args, say)
        streamer = Streamer(link, reference_of(self.joints, goal, Asked()))
        result = Rounds(link, streamer, model, goal, limits, say, transcript.keep, self.source).run()
        path = report.write(result, transcript.folder, goal, self.args.model, self.names)
        transcript.close()
        tell(doing=f"wrote {path}: {result.why}")
        if result.stopped:
            raise LitheError(result.why)
        tell(source=result.source)
        self.show_evolved()


def at_rest(arm: Arm, motions: list[Motion], name: str) -> dict[str, Any]:
    """What the rests that the torques led to say by themselves."""
    torques = [float(np.mean(motion.torque_nm[last(motion, REST_S)])) for motion in motions]
    angles = [float(np.mean(motion.position_rad[last(motion, REST_S)])) for motion in motions]
    for torque_nm, angle_rad in zip(torques, angles, strict=True):
        tell(doing=f"{torque_nm:.4f} N m holds {name} at {np.degrees(angle_rad):.1f} deg")
    rest_nm, rest_se_nm = mgl_at_rest(np.array(torques), np.array(angles), arm.coulomb_nm)
    return {
        "mgl_at_rest_nm": rest_nm,
        "mgl_at_rest_se_nm": rest_se_nm,
        "torques_nm": torques,
        "angles_rad": angles,
    }


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m lithe.demo.agent")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, required=True)
    parser.add_argument("--token-file", type=Path, required=True)
    parser.add_argument("--out", type=Path, help="where a model's transcripts go")
    options.model_options(parser, required=False)
    args = parser.parse_args()
    try:
        remote = Remote(args.host, args.port, args.token_file, timeout_s=SLOW_COMPUTER_S)
        agent = Agent(remote) if args.url is None else ModelAgent(remote, args)
        arms = agent.probe(agent.baseline())
        agent.gravity_only(arms)
        agent.evolve(arms)
    except (ValueError, LitheError) as error:
        print(f"agent: {error}", file=sys.stderr)
        return 1
    tell(phase="", from_ns=time.monotonic_ns())
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
