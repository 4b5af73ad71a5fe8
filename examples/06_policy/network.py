# SPDX-License-Identifier: Apache-2.0
"""A small network that gives a joint's torque, and the law in C++ that computes the same."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
UNITS = 6
# Of each joint: error [rad], velocity error [rad/s], velocity [rad/s], sine of the angle, setpoint's acceleration
# [rad/s^2]. No input is constant, so a joint that hangs still at 0 gets no torque.
SCALES = np.array([10.0, 0.5, 0.1, 1.0, 0.05])

LAW = """
#include <lithe/law.hpp>

constexpr std::array<std::array<double, {inputs}>, {units}> kHidden{{{{{hidden}}}}};
constexpr std::array<double, {units}> kOutput{{{output}}};
constexpr std::array<double, {joints}> kTorqueMaxNm{{{torque_max_nm}}};

struct Policy {{
  struct Params {{}};
  struct State {{}};
  static void step(const lithe::Tick& t, const Params&, State&, lithe::Effort& u) {{
    for (std::uint32_t j = 0; j < t.joints && j < kTorqueMaxNm.size(); ++j) {{
      const std::array<double, {inputs}> input{{t.setpoint_position_rad[j] - t.position_rad[j],
                                      t.setpoint_velocity_rad_s[j] - t.velocity_rad_s[j], t.velocity_rad_s[j],
                                      std::sin(t.position_rad[j]), t.setpoint_acceleration_rad_s2[j]}};
      double share = 0;
      for (std::size_t n = 0; n < kOutput.size(); ++n) {{
        double sum = 0;
        for (std::size_t i = 0; i < input.size(); ++i) sum += kHidden[n][i] * input[i];
        share += kOutput[n] * std::tanh(sum);
      }}
      u.torque_nm[j] = kTorqueMaxNm[j] * share;
    }}
  }}
}};
LITHE_LAW(Policy, "policy");
"""


class Network:
    """UNITS tanh units and one linear output, the same for every joint."""

    SIZE = UNITS * (len(SCALES) + 1)

    def __init__(self, weights: Floats) -> None:
        """`weights`, shape (SIZE,): of each unit its inputs' and its output's."""
        each = weights.reshape(UNITS, len(SCALES) + 1)
        self.hidden, self.output = each[:, :-1] * SCALES, each[:, -1]

    def share(self, *seen: Floats) -> Floats:
        """The torque as a share of the largest, from what a law sees: the FIELDS of lithe.gym, all of one shape."""
        position, velocity, setpoint, setpoint_velocity, acceleration = seen
        inputs = np.stack(
            [setpoint - position, setpoint_velocity - velocity, velocity, np.sin(position), acceleration], axis=-1
        )
        result: Floats = np.tanh(inputs @ self.hidden.T) @ self.output
        return result

    def law(self, torque_max_nm: Floats) -> str:
        """The same as C++ text, for these joints."""

        def row(values: Floats) -> str:
            return ", ".join(repr(float(value)) for value in values)

        hidden = ",\n    ".join("{" + row(unit) + "}" for unit in self.hidden)
        return LAW.format(
            inputs=len(SCALES), units=UNITS, joints=len(torque_max_nm), hidden=hidden, output=row(self.output),
            torque_max_nm=row(torque_max_nm),
        )  # fmt: skip
