# SPDX-License-Identifier: Apache-2.0
"""The supervisory agent: a process that knows the robot only through TCP, and improves its control law.

Deterministic and offline: it measures, estimates, writes C++ and asks for swaps. Nothing about the plant is built in;
it knows that there is one joint under gravity, and what the gateway tells (rate, limits). What it does goes to stdout
as JSON lines.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from lithe.identify import Arm, Motion, identify_arm, mgl_at_rest
from lithe.remote import Remote

SINE = {"centre_rad": np.pi / 2, "amplitude_rad": np.pi / 4, "frequency_hz": 0.5, "ramp_s": 1.5}
BASELINE_GAINS = {"kp_nm_rad": 0.05, "kd_nm_s_rad": 0.004}  # detuned on purpose: the experiment starts from a bad law
FIELDS = ["tick", "sample_ns", "position_rad", "velocity_rad_s", "torque_nm"]

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

EVOLVED_SOURCE = """\
// Written by the agent from its own measurements: gravity, inertia and friction feed-forward plus PD.
#include <lithe/law.hpp>

struct Evolved {{
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
LITHE_LAW(Evolved, "evolved");
"""


def tell(**what: Any) -> None:
    """One line for whoever watches."""
    print(json.dumps(what), flush=True)


class Agent:
    def __init__(self, remote: Remote, baseline_law: str) -> None:
        self.remote = remote
        self.baseline_law = baseline_law
        about = remote.call("describe")
        self.rate_hz = float(about["rate_hz"])
        self.torque_max_nm = float(about["joints"][0]["torque_max_nm"])

    def swap(self, name: str, source: str, params: dict[str, float] | None = None) -> None:
        tell(doing=f"asks for a swap to {name}", sent_ns=time.monotonic_ns())
        record = self.remote.call("swap", source=source, name=f"{name}.cpp", params=params or {})
        tell(swap={"law": name, **record})

    def record(self, seconds: float) -> Motion:
        """Telemetry of the next `seconds`, gathered piece by piece: the Brain keeps four seconds."""
        pieces: list[dict[str, Any]] = []
        since = int(self.remote.call("latest", fields=["tick"])["tick"])
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            time.sleep(min(1.0, left))
            piece = self.remote.call("history", seconds=4.0, since_tick=since, fields=FIELDS)
            if piece["tick"]:
                since = piece["tick"][-1]
                pieces.append(piece)

        def column(name: str) -> Any:
            return np.concatenate(
                [np.asarray(piece[name], dtype=float).reshape(len(piece["tick"]), -1)[:, 0] for piece in pieces]
            )

        t_s = column("sample_ns") * 1e-9
        return Motion(t_s - t_s[0], column("position_rad"), column("velocity_rad_s"), column("torque_nm"))

    def phase(self, name: str) -> None:
        tell(phase=name, from_ns=time.monotonic_ns())

    # ---- the protocol
    def baseline(self) -> Motion:
        self.swap("baseline_pd", self.baseline_law, BASELINE_GAINS)
        self.remote.call("reference", **SINE)
        time.sleep(float(SINE["ramp_s"]))
        self.phase("baseline")
        return self.record(6.0)

    def probe(self, rough: Arm) -> Arm:
        """Two constant torques, half of what gravity seems to be and a third of it the other way: a wide swing that
        cannot go over the top. Both swings and both rests are used."""
        self.phase("probing")
        motions, torques, angles = [], [], []
        for number, share in enumerate((0.5, -0.35), start=1):
            torque_nm = share * min(rough.mgl_nm, self.torque_max_nm)
            self.swap(f"probe_{number}", PROBE_SOURCE.format(number=number, torque_nm=torque_nm, ramp_s=0.05))
            motion = self.record(3.0)
            motions.append(motion)
            resting = motion.t_s > motion.t_s[-1] - 0.3
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

    def evolve(self, arm: Arm) -> None:
        """Bandwidth: a twentieth of the tick rate in rad/s leaves room for one tick of delay and the drive's lag."""
        omega = self.rate_hz / 20.0
        kp, kd = arm.inertia_kg_m2 * omega**2, 2 * 0.9 * omega * arm.inertia_kg_m2
        source = EVOLVED_SOURCE.format(
            mgl_nm=arm.mgl_nm,
            most_mgl_nm=3 * arm.mgl_nm,
            kp_nm_rad=kp,
            most_kp_nm_rad=4 * kp,
            kd_nm_s_rad=kd,
            most_kd_nm_s_rad=4 * kd,
            inertia_kg_m2=arm.inertia_kg_m2,
            coulomb_nm=max(arm.coulomb_nm, 0.0),
        )
        tell(source=source)
        self.remote.call("reference")  # rest where the arm is, so that the new law starts without an error
        time.sleep(0.3)
        self.swap("evolved", source)
        self.remote.call("reference", **SINE)
        time.sleep(float(SINE["ramp_s"]) + 0.5)
        self.phase("evolved")
        self.record(6.0)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m lithe.demo.agent")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, required=True)
    parser.add_argument("--token-file", type=Path, required=True)
    parser.add_argument("--baseline-law", type=Path, required=True, help="the law the experiment starts from")
    args = parser.parse_args()
    remote = Remote(args.host, args.port, args.token_file.read_text().strip())
    agent = Agent(remote, args.baseline_law.read_text())
    rough = identify_arm([agent.baseline()])
    tell(doing=f"reads gravity from the baseline: about {rough.mgl_nm:.2f} N m")
    agent.evolve(agent.probe(rough))
    tell(phase="done", from_ns=time.monotonic_ns())
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
