// SPDX-License-Identifier: Apache-2.0
#include "trial/core/report.hpp"

#include <algorithm>
#include <vector>

#include "spine/wire/wire.hpp"

namespace lithe::trial {
namespace {

using nlohmann::json;

json loop_json(const LoopStats& stats, std::uint32_t joints) {
  static constexpr const char* kTremors[] = {"none", "chatter", "oscillation"};
  return {{"ticks", stats.ticks},
          {"whole_ticks", stats.whole_ticks},
          {"torque_clamped", stats.torque_clamped},
          {"slew_clamped", stats.slew_clamped},
          {"position_clamped", stats.position_clamped},
          {"velocity_clamped", stats.velocity_clamped},
          {"fault", wire::to_string(static_cast<wire::Fault>(stats.fault))},
          {"most_torque_nm", stats.most_torque_nm},
          {"most_velocity_rad_s", stats.most_velocity_rad_s},
          {"rms_error_rad", stats.rms_error_rad},
          {"joint_rms_error_rad",
           std::vector<double>(stats.joint_rms_error_rad.begin(),
                               stats.joint_rms_error_rad.begin() + std::min<std::size_t>(joints, kMaxJoints))},
          {"tremor", kTremors[std::min(stats.tremor, 2u)]},
          {"tremor_hz", stats.tremor_hz},
          {"most_chatter_hz", stats.most_chatter_hz},
          {"most_swings", stats.most_swings}};
}

}  // namespace

const char* name_of(Section section) {
  static constexpr const char* kNames[] = {"load", "benign", "loop", "replay", "hostile", "timing"};
  return kNames[std::min<std::size_t>(static_cast<std::size_t>(section), kSections - 1)];
}

json to_json(const Report& report, const LoopStats& alone, const LoopStats& alone_rough, std::uint32_t joints,
             std::int64_t budget_ns) {
  json out = json::object();
  for (std::size_t i = 1; i < kSections; ++i) {
    const Progress& progress = report.progress[i];
    out[name_of(static_cast<Section>(i))] = {
        {"done", progress.done != 0}, {"steps", progress.steps}, {"ms", progress.ms}};
  }
  out["benign"].update({{"same_bits", report.same_bits != 0}, {"reset_difference_nm", report.reset_difference_nm}});
  out["loop"].update(loop_json(report.loop, joints));
  out["loop"]["without_a_law"] = loop_json(alone, joints);
  out["loop"]["rough"] = loop_json(report.rough, joints);
  out["loop"]["rough"]["without_a_law"] = loop_json(alone_rough, joints);
  if (report.carried_fields > 0) out["loop"]["carried"] = loop_json(report.carried, joints);
  if (report.carried_fields > 0) out["loop"]["carried"]["state_fields"] = report.carried_fields;
  out["replay"].update({{"records", report.replay_records},
                        {"most_torque_nm", report.replay_most_torque_nm},
                        {"takeover_step_nm", report.takeover_step_nm},
                        {"takeover_warm_step_nm", report.takeover_warm_step_nm},
                        {"takeover_joint", report.replay_joint}});
  out["hostile"].update({{"cases", report.hostile_cases},
                         {"not_finite", report.hostile_not_finite},
                         {"not_recovered", report.hostile_not_recovered},
                         {"worst_ns", report.hostile_worst_ns},
                         {"slowest", text_of(report.hostile_slowest)}});
  if (report.hostile_not_recovered > 0)
    out["hostile"]["note"] =
        "not_recovered: inputs after which the next two steps with ordinary inputs still gave NaN, because State kept "
        "it; no reason to refuse: in the Spine such a step is a law fault, and its State is not kept";
  out["timing"].update({{"inputs", report.timing_inputs},
                        {"first_ns", report.first_ns},
                        {"p50_ns", report.p50_ns},
                        {"p999_ns", report.p999_ns},
                        {"worst_best_of_3_ns", report.worst_best_of_3_ns},
                        {"worst_ns", report.worst_ns},
                        {"budget_ns", budget_ns}});
  return out;
}

}  // namespace lithe::trial
