// SPDX-License-Identifier: Apache-2.0
// What the numbers of a closed-loop run say about the law (spine/law/diagnosis.hpp).
#include <algorithm>
#include <span>

#include "spine/law/diagnosis.hpp"
#include "spine/law/tremor.hpp"
#include "trial/sections/sections.hpp"

namespace lithe::trial {
namespace {

// Swings faster than this share of the rate come from damping that is too high: with the lag of loop and drive its
// torque is then a quarter of a period late. Measured at 1 kHz on the chain: 21 Hz by too much stiffness, 50 Hz by too
// much damping.
constexpr double kFastOfRate = 0.035;

// The run that refused the law.
const LoopStats& last_run(const Report& report) {
  return report.carried.ticks > 0 ? report.carried : report.rough.ticks > 0 ? report.rough : report.loop;
}

std::uint32_t joint_of(const LoopStats& run) {
  return run.fault != 0 ? run.fault_joint : run.tremor != 0 ? run.tremor_joint : run.held_joint;
}

// What to change when the numbers of no joint show the cause. Chatter says it itself.
const char* otherwise(const LoopStats& run, double rate_hz) {
  using enum law::Tremor::Finding::Kind;
  const auto shakes = static_cast<law::Tremor::Finding::Kind>(run.tremor);
  if (run.fault != 0 || shakes == none)
    return "look at the sign and the size of its gains, and filter what it differentiates";
  if (shakes == chatter) return "";
  return run.tremor_hz < kFastOfRate * rate_hz
             ? "lower its stiffness, or raise its damping"
             : "lower the gain on its velocity: at this frequency the delay of the loop turns damping into drive";
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
  if (!passed && found.empty()) found.emplace_back(otherwise(run, setup.robot.rate_hz));
  std::erase(found, "");
  return found;
}

}  // namespace lithe::trial
