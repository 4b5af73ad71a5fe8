# SPDX-License-Identifier: Apache-2.0
"""The supervisory agent: a process that knows the robot only through TCP, and improves its control law.

Deterministic and offline: it measures, estimates, writes C++ and asks for swaps. Nothing about the plant is built in;
it knows that there is one joint under gravity, and what the gateway tells (rate, limits). What it does goes to stdout
as JSON lines.
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

from lithe.errors import LitheError
from lithe.identify import Arm, Motion, identify_arm, mgl_at_rest
from lithe.remote import Remote

SINE = {"centre_rad": np.pi / 2, "amplitude_rad": np.pi / 4, "frequency_hz": 0.5, "ramp_s": 1.5}
BAD_ON_PURPOSE = {"probation_s": 0.0}  # no law before it tracked worse, and it shall run all the same
BASELINE_GAINS = {"kp_nm_rad": 0.05, "kd_nm_s_rad": 0.004}  # detuned on purpose: the experiment starts from a bad law
FIELDS = ["tick", "sample_ns", "position_rad", "velocity_rad_s", "torque_nm"]

KEPT_TICKS = 4096  # of telemetry, by the gateway's `history`
REST_S = 0.3  # a probe has ended when the arm has rested so long
MOST_BANDWIDTH_RAD_S = 60.0  # beyond, a drive's own lag of about a millisecond eats the phase margin at any tick rate
PROBE_SHARES = (0.5, -0.35)  # of the rough gravity torque: a wide swing both ways that cannot go over the top

BASELINE_SOURCE = """\
// The law the experiment starts from, written {when}: a PD far too weak for the arm's weight.
#include <lithe/law.hpp>

struct DetunedPd {{
  struct Params {{
    lithe::Param kp_nm_rad{{{kp_nm_rad}, 0.0, 10.0}};
    lithe::Param kd_nm_s_rad{{{kd_nm_s_rad}, 0.0, 1.0}};
  }};
  struct State {{}};
  static void step(const lithe::Tick& in, const Params& p, State&, lithe::Effort& out) {{
    out.torque_nm[0] = p.kp_nm_rad * (in.setpoint_position_rad[0] - in.position_rad[0]) +
                       p.kd_nm_s_rad * (in.setpoint_velocity_rad_s[0] - in.velocity_rad_s[0]);
  }}
}};
LITHE_LAW(DetunedPd, "detuned_pd");
"""

PROBE_SOURCE = """\
// Probing law: a constant torque of {torque_nm:.6f} N m, reached over {ramp_s} s.
#include <lithe/law.hpp>

struct Probe{number} {{
  struct Params {{}};
  struct State {{
    double ramp = 0;
  }};
  static void step(const lithe::Tick& in, const Params&, State& state, lithe::Effort& out) {{
    state.ramp = std::min(1.0, state.ramp + in.dt_s / {ramp_s});
    out.torque_nm[0] = state.ramp * {torque_nm:.6f};
  }}
}};
LITHE_LAW(Probe{number}, "probe_{number}");
"""

MODEL_SOURCE = """\
// {what}
#include <lithe/law.hpp>

struct {struct} {{
  struct Params {{
    lithe::Param mgl_nm{{{mgl_nm:.6f}, 0.0, {most_mgl_nm:.6f}}};
    lithe::Param kp_nm_rad{{{kp_nm_rad:.6f}, 0.0, {most_kp_nm_rad:.6f}}};
    lithe::Param kd_nm_s_rad{{{kd_nm_s_rad:.6f}, 0.0, {most_kd_nm_s_rad:.6f}}};
  }};
  struct State {{}};
  struct Probes {{
    double error_rad = 0;
    double gravity_nm = 0;
  }};
  static void step(const lithe::Tick& in, const Params& p, State&, lithe::Effort& out, Probes& probe) {{
    constexpr double kInertia_kg_m2 = {inertia_kg_m2:.8f};
    constexpr double kCoulomb_nm = {coulomb_nm:.8f};
    constexpr double kFrictionWidth_rad_s = 0.05;
    probe.error_rad = in.setpoint_position_rad[0] - in.position_rad[0];
    probe.gravity_nm = p.mgl_nm * std::sin(in.position_rad[0]);
    out.torque_nm[0] = probe.gravity_nm + kInertia_kg_m2 * in.setpoint_acceleration_rad_s2[0] +
                       kCoulomb_nm * std::tanh(in.setpoint_velocity_rad_s[0] / kFrictionWidth_rad_s) +
                       p.kp_nm_rad * probe.error_rad +
                       p.kd_nm_s_rad * (in.setpoint_velocity_rad_s[0] - in.velocity_rad_s[0]);
  }}
}};
LITHE_LAW({struct}, "{name}");
"""
GRAVITY_ONLY = "The detuned law and the estimated gravity, nothing else: how much of the improvement is gravity's?"
EVOLVED = "Written by the agent from its own measurements: gravity, inertia and friction feed-forward plus PD."


def model_law(name: str, what: str, arm: Arm, kp_nm_rad: float, kd_nm_s_rad: float) -> str:
    """C++ of a law built on the estimate."""
    return MODEL_SOURCE.format(
        what=what,
        name=name,
        struct=name.title().replace("_", ""),
        mgl_nm=arm.mgl_nm,
        most_mgl_nm=3 * arm.mgl_nm,
        kp_nm_rad=kp_nm_rad,
        most_kp_nm_rad=4 * kp_nm_rad,
        kd_nm_s_rad=kd_nm_s_rad,
        most_kd_nm_s_rad=4 * kd_nm_s_rad,
        inertia_kg_m2=arm.inertia_kg_m2,
        coulomb_nm=max(arm.coulomb_nm, 0.0),
    )


def tell(**what: Any) -> None:
    """One line for whoever watches."""
    print(json.dumps(what), flush=True)


def as_motion(pieces: list[dict[str, Any]]) -> Motion:
    """Answers of the gateway's verb `history`, one after the other, as the first joint's motion."""

    def column(name: str) -> Any:
        return np.concatenate(
            [np.asarray(piece[name], dtype=float).reshape(len(piece["tick"]), -1)[:, 0] for piece in pieces]
        )

    t_s = column("sample_ns") * 1e-9
    return Motion(t_s - t_s[0], column("position_rad"), column("velocity_rad_s"), column("torque_nm"))


def last(motion: Motion, seconds: float) -> npt.NDArray[np.bool_]:
    """Which samples belong to the last `seconds`."""
    chosen: npt.NDArray[np.bool_] = motion.t_s > motion.t_s[-1] - seconds
    return chosen


def rests(motion: Motion) -> bool:
    """True when the arm has moved less than a tenth of a degree in the last 0.3 s."""
    return bool(np.ptp(motion.position_rad[last(motion, REST_S)]) < np.radians(0.1))


class Agent:
    def __init__(self, remote: Remote) -> None:
        self.remote = remote
        about = remote.call("describe")
        self.rate_hz = float(about["rate_hz"])
        self.torque_max_nm = float(about["joints"][0]["torque_max_nm"])

    def swap(self, name: str, source: str, **terms: float) -> None:
        tell(doing=f"asks for a swap to {name}")
        sent_ns = time.monotonic_ns()
        record = self.remote.call("swap", source=source, name=f"{name}.cpp", **terms)
        tell(swap={"law": name, "sent_ns": sent_ns, **record})

    def record(self, seconds: float, rest_by_s: float = 0.0) -> Motion:
        """Telemetry of the next `seconds`, and on until the arm rests or `rest_by_s` have passed.

        Gathered piece by piece, four times in what the Brain keeps.
        """
        pause_s = min(1.0, KEPT_TICKS / self.rate_hz / 4)
        pieces: list[dict[str, Any]] = []
        since = int(self.remote.call("latest", fields=["tick"])["tick"])
        start = time.monotonic()
        while (left := start + seconds - time.monotonic()) > 0 or not pieces:
            time.sleep(min(pause_s, max(left, 0.1)))
            piece = self.remote.call("history", seconds=4.0, since_tick=since, fields=FIELDS)
            if piece["tick"]:
                since = piece["tick"][-1]
                pieces.append(piece)
                if left <= pause_s and time.monotonic() < start + rest_by_s and not rests(as_motion(pieces)):
                    seconds += 0.5
        return as_motion(pieces)

    def rest(self, most_s: float = 2.0) -> None:
        """Until the setpoint rests where the arm does."""
        self.remote.call("reference")  # from now on the setpoint waits for the arm
        until = time.monotonic() + most_s
        while time.monotonic() < until:
            time.sleep(0.1)
            motion = as_motion([self.remote.call("history", seconds=REST_S + 0.1, fields=FIELDS)])
            if motion.t_s[-1] > REST_S and rests(motion):
                break
        self.remote.call("reference")
        self.wait_for_setpoint(most_s)

    def wait_for_setpoint(self, most_s: float) -> None:
        """Until the setpoint has come to the arm, within half a degree."""
        until = time.monotonic() + most_s
        while time.monotonic() < until:
            now = self.remote.call("latest", fields=["setpoint_position_rad", "position_rad"])
            if abs(now["setpoint_position_rad"][0] - now["position_rad"][0]) < np.radians(0.5):
                return
            time.sleep(0.05)

    def phase(self, name: str) -> None:
        tell(phase=name, from_ns=time.monotonic_ns())

    # ---- the protocol
    def baseline(self) -> Motion:
        when = time.strftime("%Y-%m-%d %H:%M:%S")
        self.swap("detuned_pd", BASELINE_SOURCE.format(when=when, **BASELINE_GAINS), **BAD_ON_PURPOSE)
        self.remote.call("reference", **SINE)
        time.sleep(float(SINE["ramp_s"]))
        self.phase("baseline")
        return self.record(6.0)

    def probe(self, rough: Arm) -> Arm:
        """Two constant torques; the swings into both rests are used, and the rests alone for comparison."""
        self.phase("probing")
        motions, torques, angles = [], [], []
        for number, share in enumerate(PROBE_SHARES, start=1):
            torque_nm = share * min(rough.mgl_nm, self.torque_max_nm)
            source = PROBE_SOURCE.format(number=number, torque_nm=torque_nm, ramp_s=0.05)
            self.swap(f"probe_{number}", source, **BAD_ON_PURPOSE)
            motion = self.record(2.5, rest_by_s=8.0)
            motions.append(motion)
            resting = last(motion, REST_S)
            torques.append(float(np.mean(motion.torque_nm[resting])))
            angles.append(float(np.mean(motion.position_rad[resting])))
            tell(doing=f"{torques[-1]:.4f} N m holds the arm at {np.degrees(angles[-1]):.1f} deg")
        arm = identify_arm(motions)
        rest_nm, rest_se_nm = mgl_at_rest(np.array(torques), np.array(angles), arm.coulomb_nm)
        tell(
            estimate={
                "mgl_hat_nm": arm.mgl_nm,
                "mgl_se_nm": arm.mgl_se_nm,
                "inertia_hat_kg_m2": arm.inertia_kg_m2,
                "coulomb_hat_nm": arm.coulomb_nm,
                "viscous_hat_nm_s_rad": arm.viscous_nm_s_rad,
                "windows": arm.windows,
                "mgl_at_rest_nm": rest_nm,
                "mgl_at_rest_se_nm": rest_se_nm,
                "torques_nm": torques,
                "angles_rad": angles,
            }
        )
        return arm

    def gravity_only(self, arm: Arm) -> None:
        """An ablation: one period of the sine with the gravity term added to the gains of the baseline."""
        tell(phase="", from_ns=time.monotonic_ns())
        gravity = replace(arm, inertia_kg_m2=0.0, coulomb_nm=0.0)
        self.rest()
        source = model_law("gravity_only", GRAVITY_ONLY, gravity, **BASELINE_GAINS)
        self.swap("gravity_only", source, **BAD_ON_PURPOSE)
        self.remote.call("reference", **SINE)
        time.sleep(float(SINE["ramp_s"]))
        self.phase("gravity_only")
        time.sleep(1 / float(SINE["frequency_hz"]))

    def evolve(self, arm: Arm) -> None:
        """Bandwidth: a twentieth of the tick rate in rad/s leaves room for one tick of delay and the drive's lag."""
        self.phase("evolving")
        omega = min(self.rate_hz / 20.0, MOST_BANDWIDTH_RAD_S)
        source = model_law("evolved", EVOLVED, arm, arm.inertia_kg_m2 * omega**2, 1.8 * omega * arm.inertia_kg_m2)
        tell(source=source)
        self.rest()  # so that the new law starts without an error
        self.swap("evolved", source)
        self.remote.call("reference", **SINE)
        time.sleep(float(SINE["ramp_s"]) + 0.5)
        self.phase("evolved")
        time.sleep(6.0)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m lithe.demo.agent")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, required=True)
    parser.add_argument("--token-file", type=Path, required=True)
    args = parser.parse_args()
    try:
        agent = Agent(Remote(args.host, args.port, args.token_file.read_text().strip()))
        rough = identify_arm([agent.baseline()])
        tell(doing=f"reads gravity from the baseline: about {rough.mgl_nm:.2f} N m")
        arm = agent.probe(rough)
        agent.gravity_only(arm)
        agent.evolve(arm)
    except (ValueError, LitheError) as error:
        print(f"agent: {error}", file=sys.stderr)
        return 1
    tell(phase="", from_ns=time.monotonic_ns())
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
