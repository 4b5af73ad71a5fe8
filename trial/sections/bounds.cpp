// SPDX-License-Identifier: Apache-2.0
// Detects a law that uses array entries beyond the robot's joints: they exist (up to kMaxJoints) but are not valid.
#include <array>
#include <cmath>
#include <cstring>

#include "spine/law/dry_inputs.hpp"
#include "trial/sections/sections.hpp"

namespace lithe::trial {
namespace {

constexpr std::uint64_t kFirstStep = 100, kMovingSteps = 8;  // of a robot that moves

struct Output {
  const char* name;
  JointArray Effort::* values;
};
constexpr std::array kOutputs = std::to_array<Output>({{"torque_nm", &Effort::torque_nm},
                                                       {"position_rad", &Effort::position_rad},
                                                       {"velocity_rad_s", &Effort::velocity_rad_s},
                                                       {"kp_nm_rad", &Effort::kp_nm_rad},
                                                       {"kd_nm_s_rad", &Effort::kd_nm_s_rad}});

// Runs the law on the same ordinary steps twice; the second time entries [from, to) of `input` hold something. False
// when the output changes, or the law was refused.
bool same_output(TrialContext& context, const JointInput& input, std::size_t from, std::size_t to) {
  context.one.reset();
  context.other.reset();
  Tick tick, other;
  for (std::uint64_t k = 0; k < kMovingSteps; ++k) {
    law::dry_input(tick, kFirstStep + k, context.joints());
    other = tick;
    for (std::size_t j = from; j < to; ++j) (other.*input.values)[j] = 1 + 0.5 * static_cast<double>(j + k);
    context.one.step(tick);
    context.other.step(other);
    if (!context.sound(context.one) || !context.sound(context.other)) return false;
    if (!context.same_bits()) return false;
  }
  return true;
}

}  // namespace

bool TrialContext::same_bits() {
  for (const Output& output : kOutputs) {
    const JointArray &a = one.effort().*output.values, &b = other.effort().*output.values;
    if (std::memcmp(a.data(), b.data(), joints() * sizeof(double)) != 0) return false;
  }
  return std::memcmp(one.probes().data(), other.probes().data(), law.probe_count * sizeof(double)) == 0;
}

// Unchanged entries are accepted, and zeros too (a law may clear the whole array).
bool TrialContext::within_joints(const LawHarness& harness) {
  for (std::size_t i = 0; i < kOutputs.size(); ++i) {
    const Output& output = kOutputs[i];
    const JointArray& values = harness.effort().*output.values;
    for (std::size_t j = joints(); j < kMaxJoints; ++j) {
      const bool absent = output.values == &Effort::position_rad && std::isnan(values[j]);
      if (absent || values[j] == 0) continue;
      if (i > 0) {
        return refuse(
            "it writes %s[%zu] (or %s[%zu], beyond that array), but this robot has %u joints, 0 to %u (%s): count to "
            "t.joints, not to another number",
            output.name, j, kOutputs[i - 1].name, j + kMaxJoints, joints(), joints() - 1, report.doing.data());
      }
      return refuse(
          "it writes %s[%zu], but this robot has %u joints, 0 to %u (%s): count to t.joints, not to another number",
          output.name, j, joints(), joints() - 1, report.doing.data());
    }
  }
  return true;
}

bool reads_within_joints(TrialContext& context) {
  const std::size_t joints = context.joints();
  for (const JointInput& input : kJointInputs) {
    context.doing("tried with other values of %s beyond these joints", input.name);
    if (same_output(context, input, joints, kMaxJoints)) continue;
    if (context.report.refused[0] != '\0') return false;
    std::size_t first = joints;
    while (first + 1 < kMaxJoints && same_output(context, input, first, first + 1)) ++first;
    return context.refuse(
        "it reads %s[%zu], but this robot has %zu joints, 0 to %zu: count to t.joints, not to another number",
        input.name, first, joints, joints - 1);
  }
  return true;
}

}  // namespace lithe::trial
