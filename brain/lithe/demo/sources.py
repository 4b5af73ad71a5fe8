# SPDX-License-Identifier: Apache-2.0
"""The laws that the agent writes, as C++: a table with a row for each joint, and one loop over it.

A law has at most 32 live parameters, so a table is constant and the parameters are factors on all of its rows.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from lithe.identify import Arm

RAMP_S = 0.05  # to the full torque of a probe

BASELINE = """\
// The law the experiment starts from, written {when}: PDs far too weak for what the joints carry.
#include <lithe/law.hpp>

struct DetunedPd {{
  struct Params {{  // factors on the table
    lithe::Param stiffness{{1.0, 0.0, 4.0}};
    lithe::Param damping{{1.0, 0.0, 4.0}};
  }};
  struct State {{}};
  struct Joint {{
    double kp_nm_rad, kd_nm_s_rad;
  }};
  static constexpr std::array<Joint, {count}> kJoints{{{{
{rows}
  }}}};
  static void step(const lithe::Tick& in, const Params& p, State&, lithe::Effort& out) {{
    for (std::size_t j = 0; j < kJoints.size(); ++j) {{
      out.torque_nm[j] =
          p.stiffness * kJoints[j].kp_nm_rad * (in.setpoint_position_rad[j] - in.position_rad[j]) +
          p.damping * kJoints[j].kd_nm_s_rad * (in.setpoint_velocity_rad_s[j] - in.velocity_rad_s[j]);
    }}
  }}
}};
LITHE_LAW(DetunedPd, "detuned_pd");
"""

PROBE = """\
// Probing law: constant torques, reached over {ramp_s} s. A joint with gains instead follows the setpoint.
#include <lithe/law.hpp>

struct Probe{number} {{
  struct Params {{}};
  struct State {{
    double ramp = 0;
  }};
  struct Joint {{
    double torque_nm, kp_nm_rad, kd_nm_s_rad;
  }};
  static constexpr std::array<Joint, {count}> kJoints{{{{
{rows}
  }}}};
  static void step(const lithe::Tick& in, const Params&, State& state, lithe::Effort& out) {{
    state.ramp = std::min(1.0, state.ramp + in.dt_s / {ramp_s});
    for (std::size_t j = 0; j < kJoints.size(); ++j) {{
      out.torque_nm[j] =
          state.ramp * kJoints[j].torque_nm +
          kJoints[j].kp_nm_rad * (in.setpoint_position_rad[j] - in.position_rad[j]) +
          kJoints[j].kd_nm_s_rad * (in.setpoint_velocity_rad_s[j] - in.velocity_rad_s[j]);
    }}
  }}
}};
LITHE_LAW(Probe{number}, "probe_{number}");
"""

MODEL = """\
// {what}
#include <lithe/law.hpp>

struct {struct} {{
  struct Params {{  // factors on the table
    lithe::Param gravity{{1.0, 0.0, 3.0}};
    lithe::Param stiffness{{1.0, 0.0, 4.0}};
    lithe::Param damping{{1.0, 0.0, 4.0}};
  }};
  struct State {{}};
  struct Probes {{  // of the first joint
    double error_rad = 0;
    double gravity_nm = 0;
  }};
  struct Joint {{
    double mgl_nm, inertia_kg_m2, coulomb_nm, kp_nm_rad, kd_nm_s_rad;
  }};
  static constexpr std::array<Joint, {count}> kJoints{{{{
{rows}
  }}}};
  static constexpr double kFrictionWidth_rad_s = 0.05;
  static void step(const lithe::Tick& in, const Params& p, State&, lithe::Effort& out, Probes& probe) {{
    for (std::size_t j = 0; j < kJoints.size(); ++j) {{
      const Joint& joint = kJoints[j];
      const double error_rad = in.setpoint_position_rad[j] - in.position_rad[j];
      const double gravity_nm = p.gravity * joint.mgl_nm * std::sin(in.position_rad[j]);
      out.torque_nm[j] = gravity_nm + joint.inertia_kg_m2 * in.setpoint_acceleration_rad_s2[j] +
                         joint.coulomb_nm * std::tanh(in.setpoint_velocity_rad_s[j] / kFrictionWidth_rad_s) +
                         p.stiffness * joint.kp_nm_rad * error_rad +
                         p.damping * joint.kd_nm_s_rad * (in.setpoint_velocity_rad_s[j] - in.velocity_rad_s[j]);
    }}
    probe.error_rad = in.setpoint_position_rad[0] - in.position_rad[0];
    probe.gravity_nm = p.gravity * kJoints[0].mgl_nm * std::sin(in.position_rad[0]);
  }}
}};
LITHE_LAW({struct}, "{name}");
"""
GRAVITY_ONLY = "The detuned law and the estimated gravity, nothing else: how much of the improvement is gravity's?"
EVOLVED = "Written by the agent from its own measurements: gravity, inertia and friction feed-forward plus PD."


@dataclass(frozen=True)
class Gains:
    """Of one joint's PD."""

    kp_nm_rad: float
    kd_nm_s_rad: float

    def times(self, factor: float) -> Gains:
        return Gains(factor * self.kp_nm_rad, factor * self.kd_nm_s_rad)


def _rows(names: Sequence[str], table: Sequence[tuple[float, ...]]) -> dict[str, object]:
    """A row of the table for each joint. A name that is no word must not end the comment it stands in."""
    lines = [
        f"      {{{', '.join(f'{value:.8g}' for value in row)}}},  // {re.sub(r'[^A-Za-z0-9_-]', '?', name)}"
        for name, row in zip(names, table, strict=True)
    ]
    return {"rows": "\n".join(lines), "count": len(table)}


def baseline(names: Sequence[str], gains: Sequence[Gains], when: str) -> str:
    """C++ of the law the experiment starts from."""
    return BASELINE.format(when=when, **_rows(names, [(one.kp_nm_rad, one.kd_nm_s_rad) for one in gains]))


def probe(number: int, names: Sequence[str], torques_nm: Sequence[float | None], gains: Sequence[Gains]) -> str:
    """C++ of a probe: a constant torque, or where that is None a PD."""
    table = [
        (0.0, one.kp_nm_rad, one.kd_nm_s_rad) if torque_nm is None else (torque_nm, 0.0, 0.0)
        for torque_nm, one in zip(torques_nm, gains, strict=True)
    ]
    return PROBE.format(number=number, ramp_s=RAMP_S, **_rows(names, table))


def model(law: str, what: str, names: Sequence[str], arms: Sequence[Arm], gains: Sequence[Gains]) -> str:
    """C++ of a law built on the estimates."""
    table = [
        (arm.mgl_nm, arm.inertia_kg_m2, max(arm.coulomb_nm, 0.0), one.kp_nm_rad, one.kd_nm_s_rad)
        for arm, one in zip(arms, gains, strict=True)
    ]
    return MODEL.format(what=what, name=law, struct=law.title().replace("_", ""), **_rows(names, table))
