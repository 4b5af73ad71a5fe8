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
double takeover_nm(Bench& bench, const Tick& tick, std::size_t i) {
  double most_nm = 0;
  for (std::uint32_t j = 0; j < bench.joints(); ++j) {
    const double wanted_nm = pd_of(bench.one.effort(), j).felt_nm(tick.position_rad[j], tick.velocity_rad_s[j]);
    const double step_nm = std::abs(wanted_nm - bench.recording.command_torque_nm(i, j));
    if (step_nm > most_nm) bench.report.replay_joint = j;
    most_nm = std::max(most_nm, step_nm);
  }
  return most_nm;
}

bool bounded(Bench& bench) {
  for (std::uint32_t j = 0; j < bench.joints(); ++j) {
    const robot::JointConfig& joint = bench.setting.robot.joints[j];
    const double torque_nm = std::abs(bench.one.effort().torque_nm[j]);
    bench.report.replay_most_torque_nm = std::max(bench.report.replay_most_torque_nm, torque_nm);
    if (torque_nm <= kManyTimes * joint.torque_max_nm) continue;
    return bench.refuse(
        "on what this robot did in the last seconds it asks joint %s for %.3g Nm (%s); the joint has "
        "%.3g Nm: look for a gain that diverges",
        joint.name.c_str(), torque_nm, bench.report.doing.data(), joint.torque_max_nm);
  }
  return true;
}

}  // namespace

// When time is short, starts in the middle of the recording: the newest records matter most.
bool run_replay(Bench& bench) {
  const std::size_t records = bench.recording.size();
  bench.report.replay_records = static_cast<std::uint32_t>(records);
  if (records == 0) return true;
  Tick tick;
  bench.one.reset();
  const std::size_t last = records - 1;
  bench.doing("the newest of %u records of this robot", static_cast<unsigned>(records));
  bench.recording.fill(tick, last);
  tick.t_s = 0;
  bench.one.step(tick);
  if (!bench.sound(bench.one)) return false;
  bench.report.takeover_step_nm = takeover_nm(bench, tick, last);

  bench.one.reset();
  for (std::size_t i = 0; i < records; ++i) {
    if (i >= kMandatoryRecords && i + kMandatoryRecords < records && bench.out_of_time()) {
      i = records - kMandatoryRecords;
    }
    bench.doing("record %u of %u of this robot", static_cast<unsigned>(i), static_cast<unsigned>(records));
    bench.recording.fill(tick, i);
    bench.one.step(tick);
    ++bench.progress().steps;
    if (!bench.sound(bench.one) || !bounded(bench)) return false;
  }
  bench.report.takeover_warm_step_nm = takeover_nm(bench, tick, last);
  return true;
}

}  // namespace lithe::trial
