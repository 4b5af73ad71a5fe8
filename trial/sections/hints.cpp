// SPDX-License-Identifier: Apache-2.0
// What the numbers of a closed-loop run say about the law (spine/law/diagnosis.hpp).
#include <algorithm>
#include <span>

#include "spine/law/diagnosis.hpp"
#include "spine/law/tremor.hpp"
#include "trial/sections/sections.hpp"

namespace lithe::trial {
namespace {

// The run that refused the law: the second one when there was one.
const LoopStats& last_run(const Report& report) { return report.rough.ticks > 0 ? report.rough : report.loop; }

std::uint32_t joint_of(const LoopStats& run) {
  return run.fault != 0 ? run.fault_joint : run.tremor != 0 ? run.tremor_joint : run.held_joint;
}

}  // namespace

std::vector<std::string> hints(const Report& report, const TrialSetup& setup, bool passed) {
  if (!passed && report.section != static_cast<std::uint32_t>(Section::loop)) return {};
  const LoopStats& run = passed ? report.loop : last_run(report);
  const bool swings = run.tremor == static_cast<std::uint32_t>(law::Tremor::Finding::Kind::oscillation);
  const std::span params = std::span(report.param_values).first(std::min<std::size_t>(report.params, kMaxParams));
  std::vector<std::string> found;
  const auto look_at = [&](std::uint32_t j) {
    const robot::JointConfig& joint = setup.robot.joints[j];
    const double swing_hz = swings && j == run.tremor_joint ? run.tremor_hz : 0;
    const law::Diagnosis diagnosis =
        law::diagnose(report.sums[j], {joint.name.c_str(), joint.torque_max_nm, swing_hz, !passed, params});
    if (diagnosis.kind != law::Diagnosis::Kind::none) found.push_back(text_of(diagnosis.text));
  };
  if (!passed) look_at(joint_of(run));
  // Of a refused law whose joint shows nothing: another one may have thrown it.
  for (std::uint32_t j = 0; j < setup.joints() && (passed || found.empty()); ++j) look_at(j);
  return found;
}

}  // namespace lithe::trial
