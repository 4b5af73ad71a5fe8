// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/sections.hpp"

namespace lithe::robot {
namespace {

constexpr double kBig = 1.0e6;
constexpr double kSmall = 1.0e-9;

}  // namespace

void read_spine(Reader& in, SpineConfig& spine) {
  in.choice<Release>("release", spine.release,
                     {{"spin", Release::spin}, {"hybrid", Release::hybrid}, {"sleep", Release::sleep}});
  in.choice<TransportPlace>(
      "transport", spine.transport,
      {{"auto", TransportPlace::automatic}, {"thread", TransportPlace::thread}, {"inline", TransportPlace::inlined}});
  in.choice<LawLoader>("loader", spine.loader, {{"arena", LawLoader::arena}, {"dlopen", LawLoader::dlopen}});
  in.core("cpu_spine", spine.cpu_spine);
  in.core("cpu_transport", spine.cpu_transport);
  in.core("cpu_brain", spine.cpu_brain);
  in.core("cpu_housekeeping", spine.cpu_housekeeping);
  in.integer("late_ticks_to_stop", spine.late_ticks_to_stop, {1, 10'000});
  in.choice<MissPolicy>("miss_policy", spine.miss_policy, {{"skip", MissPolicy::skip}, {"stop", MissPolicy::stop}});
  in.integer("phase_ns", spine.phase_ns, {0, 999'999});
  in.finish();
}

void read_guard(Reader& in, GuardConfig& guard) {
  in.choice<SafeEnd>("safe_end", guard.safe_end, {{"damp", SafeEnd::damp}, {"hold", SafeEnd::hold}});
  in.number("soft_stop_rad", guard.soft_stop_rad, {0.0, 10.0});
  in.number("position_overrun_rad", guard.position_overrun_rad, {0.0, kBig});
  in.number("velocity_overrun", guard.velocity_overrun, {1.0, 100.0});
  in.finish();
}

void read_brain(Reader& in, BrainConfig& brain) {
  in.number("stale_after_s", brain.stale_after_s, {0.01, 3600.0});
  in.choice<StaleAction>("on_stale", brain.on_stale,
                         {{"hold", StaleAction::hold}, {"safe_stop", StaleAction::safe_stop}});
  in.finish();
}

void read_swap(Reader& in, SwapConfig& swap) {
  in.number("budget_share", swap.budget_share, {0.01, 0.9});
  in.number("blend_s", swap.blend_s, {0.0, 10.0});
  in.number("probation_s", swap.probation_s, {0.0, 3600.0});
  in.number("probation_error_ratio", swap.probation_error_ratio, {0.0, kBig});
  in.finish();
}

void read_device(Reader& in, DeviceConfig& device, const std::vector<std::string_view>& buses, Need need) {
  in.choice<DeviceKind>("kind", device.kind, {{"moteus", DeviceKind::moteus}}, need);
  in.reference("bus", device.bus, "bus", buses, need);
  in.number("watchdog_s", device.watchdog_s, {0.005, 10.0});
}

void read_plant(Reader& in, PlantConfig& sim) {
  in.number("inertia_kg_m2", sim.inertia_kg_m2, {1.0e-7, 1.0e4});
  in.number("mgl_nm", sim.mgl_nm, {-kBig, kBig});
  in.number("viscous_nm_s_rad", sim.viscous_nm_s_rad, {0.0, kBig});
  in.number("coulomb_nm", sim.coulomb_nm, {0.0, kBig});
  in.number("cogging_nm", sim.cogging_nm, {0.0, kBig});
  in.integer("cogging_per_rev", sim.cogging_per_rev, {1, 10'000});
  in.number("torque_lag_s", sim.torque_lag_s, {0.0, 1.0});
  in.integer("encoder_counts", sim.encoder_counts, {16, 16'777'216});
  in.number("initial_position_rad", sim.initial_position_rad, {-1.0e4, 1.0e4});
  in.integer("seed", sim.seed, {0, 9.0e15});
  in.finish();
}

void read_joint(Reader& in, JointConfig& joint, Need need) {
  int sign = joint.sign < 0 ? -1 : 1;
  in.integer("sign", sign, {-1, 1});
  if (sign == 0) in.complain("sign", "0 will not do; give 1 or -1");
  joint.sign = sign;
  in.number("zero_rad", joint.zero_rad, {-1.0e4, 1.0e4});
  in.number("ratio", joint.ratio, {1.0e-3, 1.0e4});
  in.number("position_min_rad", joint.position_min_rad, {-1.0e4, 1.0e4}, need);
  in.number("position_max_rad", joint.position_max_rad, {-1.0e4, 1.0e4}, need);
  in.number("velocity_max_rad_s", joint.velocity_max_rad_s, {kSmall, 1.0e4}, need);
  in.number("torque_max_nm", joint.torque_max_nm, {kSmall, kBig}, need);
  in.number("torque_slew_nm_s", joint.torque_slew_nm_s, {kSmall, 1.0e9}, need);
  in.number("deceleration_rad_s2", joint.deceleration_rad_s2, {1.0e-3, kBig});
  in.boolean("monotone", joint.monotone);
  in.number("kp_max_nm_rad", joint.kp_max_nm_rad, {0.0, kBig});
  in.number("kd_max_nm_s_rad", joint.kd_max_nm_s_rad, {0.0, kBig});
  in.number("safe_kp_nm_rad", joint.safe_kp_nm_rad, {0.0, kBig});
  in.number("safe_kd_nm_s_rad", joint.safe_kd_nm_s_rad, {kSmall, kBig}, need);
}

}  // namespace lithe::robot
