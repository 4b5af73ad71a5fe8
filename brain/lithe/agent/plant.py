# SPDX-License-Identifier: Apache-2.0
"""What is identified of the robot from the motion so far, as the model is told it. Pure functions."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..identify import Arm, Description, Motion, identify_chain, identify_joint

MOST_COUPLED = 3  # measurements; 4 s tell a chain of three within some per cent, and six would take seconds to fit
UNITS = {"kg m2": "kg_m2", "kg m": "kg_m", "N m s/rad": "nm_s_rad", "N m": "nm", "s": "s"}
SINGLE = """\
Gravity torque of a joint that hangs at angle 0 is about gravity_nm * sin(position + gravity_zero_rad)."""
CHAIN = """\
The joints are coupled, link after link. q_k is the angle of joint k, theta_i = q_1 + ... + q_i that of link i from
straight down, w_i its speed, a_i its acceleration; C inertia, mu moment, R rotor, b viscous, c coulomb, L length_m,
g gravity_m_s2:
torque_k = R_k * (acceleration of q_k) + b_k * (speed of q_k) + c_k * sign(speed of q_k)
  + sum over links i from k to the last: ( g * mu_i * sin(theta_i) + sum over all links j:
      ( A_ij * a_j + H_ij * w_j * w_j ) )
with A_ii = C_i, H_ii = 0, and for i != j, of which n is the nearer to the base and f the farther:
  A_ij = L_n * mu_f * cos(theta_i - theta_j), H_ij = L_n * mu_f * sin(theta_i - theta_j)."""


def identified(
    names: list[str], measurements: list[list[Motion]], chain: Description | None = None
) -> tuple[str, list[dict[str, Any]]]:
    """The equations of the model, and its values joint by joint, from all measurements (each a Motion per joint).

    Of a chain the coupled model; where the motion does not tell that, the reason, and each joint by itself.
    """
    if chain is None:
        return SINGLE, _single(names, measurements)
    try:
        return CHAIN, _coupled(chain, measurements)
    except (ValueError, np.linalg.LinAlgError) as error:
        return SINGLE, [{"coupled": "not identified", "why": str(error)}, *_single(names, measurements)]


def _coupled(chain: Description, measurements: list[list[Motion]]) -> list[dict[str, Any]]:
    fit = identify_chain(chain, measurements[-MOST_COUPLED:])
    found: list[dict[str, Any]] = [{"gravity_m_s2": chain.gravity_m_s2}]
    for name, length_m in zip(chain.names, chain.length_m, strict=True):
        one: dict[str, Any] = {"joint": name, "length_m": length_m}
        for each in fit.parameters:
            if each.joint == name:
                one[f"{each.name}_{UNITS[each.unit]}"] = float(f"{each.value:.4g}")
                one[f"{each.name}_se"] = float(f"{each.error:.2g}")
        found.append(one)
    return found + [{"warning": each} for each in fit.warnings]


def _single(names: list[str], measurements: list[list[Motion]]) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    for name, those in zip(names, zip(*measurements, strict=True), strict=True):
        try:
            arm: Arm = identify_joint(list(those))
        except (ValueError, np.linalg.LinAlgError) as error:
            found.append({"joint": name, "unknown": str(error)})
            continue
        found.append({
            "joint": name,
            "gravity_nm": round(arm.mgl_nm, 5), "gravity_se_nm": round(arm.mgl_se_nm, 5),
            "gravity_zero_rad": round(arm.zero_rad, 4),
            "inertia_kg_m2": float(f"{arm.inertia_kg_m2:.4g}"), "coulomb_nm": round(max(arm.coulomb_nm, 0.0), 5),
            "viscous_nm_s_rad": round(arm.viscous_nm_s_rad, 5),
        })  # fmt: skip
    return found
