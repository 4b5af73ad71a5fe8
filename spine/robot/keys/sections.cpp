// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/keys/sections.hpp"

#include <algorithm>

#include "spine/robot/robot.hpp"

namespace lithe::robot {
namespace {

constexpr double kSmall = 1.0e-9;

template <class Rows>
auto words_of(const Rows& rows) {
  std::vector<std::pair<std::string_view, decltype(rows[0].kind)>> words;
  for (const auto& row : rows) words.emplace_back(row.word, row.kind);
  return words;
}

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
  in.integer("lost_after_misses", guard.lost_after_misses, {1, 100'000});
  in.choice<OtherGroups>("other_groups", guard.other_groups,
                         {{"stop", OtherGroups::stop}, {"continue", OtherGroups::go_on}});
  in.number("soft_start_s", guard.soft_start_s, {0.0, 60.0});
  in.number("recover_torque_share", guard.recover_torque_share, {0.01, 1.0});
  in.number("recover_velocity_rad_s", guard.recover_velocity_rad_s, {0.01, 10.0});
  in.number("brake_after_s", guard.brake_after_s, {0.0, 3600.0});
  in.number("off_after_s", guard.off_after_s, {0.0, 3600.0});
  in.finish();
}

void read_brain(Reader& in, BrainConfig& brain) {
  in.number("stale_after_s", brain.stale_after_s, {0.01, 3600.0});
  in.choice<StaleAction>("on_stale", brain.on_stale,
                         {{"hold", StaleAction::hold}, {"safe_stop", StaleAction::safe_stop}});
  in.choice<MissPolicy>("on_torn_plan", brain.on_torn_plan, {{"skip", MissPolicy::skip}, {"stop", MissPolicy::stop}});
  in.finish();
}

void read_swap(Reader& in, SwapConfig& swap) {
  in.number("budget_share", swap.budget_share, {0.01, 0.9});
  in.number("blend_s", swap.blend_s, {0.0, 10.0});
  in.number("probation_s", swap.probation_s, {0.0, 3600.0});
  in.number("probation_error_ratio", swap.probation_error_ratio, {0.0, kBig});
  in.choice<WatchAction>(
      "watch", swap.watch,
      {{"alarm", WatchAction::alarm}, {"stop", WatchAction::stop}, {"last_good", WatchAction::last_good}});
  in.number("compile_s", swap.compile_s, {1.0, 600.0});
  in.finish();
}

bool read_bus(Reader& in, BusConfig& bus, double rate_hz) {
  if (!in.choice<BusKind>("kind", bus.kind, words_of(kBusFacts), Need::required)) return false;
  const BusFacts& kind = facts(bus.kind);
  bus.data_bitrate = kind.data_bitrate;
  in.integer("bitrate", bus.bitrate, {kLeastBitrate, kMostBitrate});
  in.integer("data_bitrate", bus.data_bitrate, {0, kMostDataBitrate});
  if (is_fd(bus) && bus.data_bitrate < bus.bitrate)
    in.complain("data_bitrate", "is slower than bitrate; 0 means classic CAN only");
  if (is_serial(bus)) {
    in.text("path", bus.path, Need::required);
    in.integer("baud", bus.baud, {9'600, 4'000'000});
  }
  if (kind.read != nullptr) kind.read(in, bus.keys);
  if (!kind.own_rates.empty() && (bus.bitrate != BusConfig{}.bitrate || bus.data_bitrate != kind.data_bitrate))
    in.complain(bus.bitrate != BusConfig{}.bitrate ? "bitrate" : "data_bitrate", std::string(kind.own_rates));
  if (kind.place == PlaceKey::interface) in.text("interface", bus.interface, Need::required);
  if (kind.place == PlaceKey::connector)
    in.integer("connector", bus.connector, {1, static_cast<double>(kind.connectors)}, Need::required);
  // Behind a serial line an answer takes longer than a fast tick. On other buses a lost answer must not delay the next
  // tick.
  constexpr double kShareOfTick = 0.96;
  if (!is_serial(bus)) bus.reply_wait_s = std::min(bus.reply_wait_s, kShareOfTick / rate_hz);
  if (kind.real) in.number("reply_wait_s", bus.reply_wait_s, {0.0, 0.1});
  in.finish();
  return true;
}

bool read_device(Reader& in, DeviceConfig& device, const std::vector<std::string_view>& buses, Need need) {
  if (!in.choice<DeviceKind>("kind", device.kind, words_of(kDeviceFacts), need)) return false;
  in.reference("bus", device.bus, "bus", buses, need);
  in.number("watchdog_s", device.watchdog_s, {0.005, 10.0});
  const std::uint32_t inherited = device.rate_divider;
  in.integer("rate_divider", device.rate_divider, {1, 1000});
  const DeviceFacts& kind = facts(device.kind);
  if (!kind.asked) {
    if (device.rate_divider != inherited)
      in.complain("rate_divider", std::string(kind.noun) + " is not asked; leave it out");
    device.rate_divider = 1;
  }
  if (kind.read != nullptr) kind.read(in, device.keys, device.watchdog_s, need);
  return true;
}

void read_sensor(Reader& in, SensorConfig& sensor, const std::vector<std::string_view>& devices) {
  in.reference("device", sensor.device, "device", devices);
  in.choice<SensorKind>("kind", sensor.kind,
                        {{"analog", SensorKind::analog}, {"digital", SensorKind::digital}, {"imu", SensorKind::imu}},
                        Need::required);
  in.integer("channel", sensor.channel, {0, 15}, Need::required);
  in.number("scale", sensor.scale, {-kBig, kBig});
  in.number("offset", sensor.offset, {-kBig, kBig});
  in.finish();
}

void read_joint(Reader& in, JointConfig& joint, Need need) {
  in.identifier("group", joint.group, Need::optional);
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
  in.number("power_max_w", joint.power_max_w, {0.0, kBig});
  in.boolean("must_be_homed", joint.must_be_homed);
  in.number("deceleration_rad_s2", joint.deceleration_rad_s2, {1.0e-3, kBig});
  in.boolean("monotone", joint.monotone);
  in.number("kp_max_nm_rad", joint.kp_max_nm_rad, {0.0, kBig});
  in.number("kd_max_nm_s_rad", joint.kd_max_nm_s_rad, {0.0, kBig});
  in.number("safe_kp_nm_rad", joint.safe_kp_nm_rad, {0.0, kBig});
  in.number("safe_kd_nm_s_rad", joint.safe_kd_nm_s_rad, {kSmall, kBig}, need);
  in.number("load_max_nm", joint.load_max_nm, {0.0, kBig});
  in.number("inertia_max_kg_m2", joint.inertia_max_kg_m2, {1.0e-7, kBig});
  in.number("inertia_min_kg_m2", joint.inertia_min_kg_m2, {1.0e-7, kBig});
  in.number("drive_lag_s", joint.drive_lag_s, {0.0, 1.0});
}

}  // namespace lithe::robot
