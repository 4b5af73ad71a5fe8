// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>

#include "spine/core/pd.hpp"
#include "trial/sections/sections.hpp"

namespace lithe::trial {
namespace {

constexpr std::size_t kMandatoryRecords = 100;
constexpr double kManyTimes = 1000;  // times a joint's torque limit: not a plausible output

// Largest difference over the joints between the law's torque and the present torque.
double takeover_nm(TrialContext& context, const Tick& tick, std::size_t i) {
  double most_nm = 0;
  for (std::uint32_t j = 0; j < context.joints(); ++j) {
    const double wanted_nm = pd_of(context.one.effort(), j).felt_nm(tick.position_rad[j], tick.velocity_rad_s[j]);
    const double step_nm = std::abs(wanted_nm - context.recording.command_torque_nm(i, j));
    if (step_nm > most_nm) context.report.replay_joint = j;
    most_nm = std::max(most_nm, step_nm);
  }
  return most_nm;
}

bool bounded(TrialContext& context) {
  for (std::uint32_t j = 0; j < context.joints(); ++j) {
    const robot::JointConfig& joint = context.setup.robot.joints[j];
    const double torque_nm = std::abs(context.one.effort().torque_nm[j]);
    context.report.replay_most_torque_nm = std::max(context.report.replay_most_torque_nm, torque_nm);
    if (torque_nm <= kManyTimes * joint.torque_max_nm) continue;
    return context.refuse(
        "on what this robot did in the last seconds it asks joint %s for %.3g Nm (%s); the joint has "
        "%.3g Nm: look for a gain that diverges",
        joint.name.c_str(), torque_nm, context.report.doing.data(), joint.torque_max_nm);
  }
  return true;
}

}  // namespace

// When its time is over, it skips the middle of the recording: the newest records matter most.
bool run_replay(TrialContext& context) {
  const std::size_t records = context.recording.size();
  context.report.replay_records = static_cast<std::uint32_t>(records);
  if (records == 0) return true;
  Tick tick;
  context.one.reset();
  const std::size_t last = records - 1;
  context.doing("the newest of %u records of this robot", static_cast<unsigned>(records));
  context.recording.fill(tick, last);
  tick.t_s = 0;
  context.one.step(tick);
  if (!context.sound(context.one)) return false;
  context.report.takeover_step_nm = takeover_nm(context, tick, last);

  context.one.reset();
  for (std::size_t i = 0; i < records; ++i) {
    if (i >= kMandatoryRecords && i + kMandatoryRecords < records && context.out_of_time())
      i = records - kMandatoryRecords;
    context.doing("record %u of %u of this robot", static_cast<unsigned>(i), static_cast<unsigned>(records));
    context.recording.fill(tick, i);
    context.one.step(tick);
    ++context.progress().steps;
    if (!context.sound(context.one) || !bounded(context)) return false;
  }
  context.report.takeover_warm_step_nm = takeover_nm(context, tick, last);
  return true;
}

}  // namespace lithe::trial
