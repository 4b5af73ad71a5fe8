// SPDX-License-Identifier: Apache-2.0
// A drive in a robot file, and the words for it.

#include <fmt/format.h>

#include <algorithm>

#include "spine/hal/canopen/canopen_master.hpp"
#include "spine/hal/canopen/canopen_text.hpp"
#include "spine/hal/cia402/cia402_drive.hpp"

namespace lithe::hal::cia402 {
namespace {

constexpr std::uint32_t kUnnamedClass = 0xff;  // of a drive that failed and sent no emergency

constexpr canopen::Names kObjects[] = {
    {object::kAbortConnection, "abort connection"},
    {object::kErrorCode, "error code"},
    {object::kControlword, "control"},
    {object::kStatusword, "status"},
    {object::kQuickStopOption, "quick stop option"},
    {object::kMode, "mode"},
    {object::kModeDisplay, "mode display"},
    {object::kPosition, "position"},
    {object::kVelocity, "velocity"},
    {object::kTargetTorque, "target torque"},
    {object::kMaxTorque, "most torque"},
    {object::kRatedTorque, "rated torque mNm"},
    {object::kTorque, "torque"},
    {object::kTargetPosition, "target position"},
    {object::kTorqueOffset, "torque offset"},
    {object::kTargetVelocity, "target velocity"},
    {object::kSupportedModes, "supported modes"},
};

// Of all drives on a bus.
struct Together {
  double watchdog_s = 10;  // the shortest
  std::uint32_t divider = 1;
};

Together together_on(const robot::RobotConfig& robot, std::size_t bus) {
  Together all;
  for (const robot::DeviceConfig& device : robot.devices) {
    if (device.bus != bus || device.kind != robot::DeviceKind::cia402) continue;
    all.watchdog_s = std::min(all.watchdog_s, device.watchdog_s);
    all.divider = device.rate_divider;
  }
  return all;
}

std::string control_text(std::uint32_t word) {
  if ((word & control::kFaultReset) != 0) return "fault reset";
  if ((word & 0x02) == 0) return "disable voltage";
  if ((word & 0x04) == 0) return "quick stop";
  if ((word & 0x01) == 0) return "shutdown";
  return (word & 0x08) != 0 ? "enable" : "switch on";
}

}  // namespace

DriverParams params_of(const robot::RobotConfig& robot, const robot::JointConfig& joint) {
  const robot::DeviceConfig& device = robot.devices[joint.device];
  DriverParams params;
  params.id = device.id;
  params.watchdog_s = device.watchdog_s;
  params.period_s = device.rate_divider / robot.rate_hz;
  params.divider = device.rate_divider;
  params.lost_after_misses = robot.guard.lost_after_misses;
  params.mode = device.keys.cia402.mode;
  params.counts_per_rev = device.keys.cia402.counts_per_rev;
  params.rated_torque_nm = device.keys.cia402.rated_torque_nm;
  params.torque_max_nm = joint.torque_max_nm;
  params.torque_slew_nm_s = joint.torque_slew_nm_s;
  params.velocity_max_rad_s = joint.velocity_max_rad_s;
  params.velocity_fault_rad_s = joint.velocity_max_rad_s * robot.guard.velocity_overrun;
  params.deceleration_rad_s2 = joint.deceleration_rad_s2;
  params.position_min_rad = joint.position_min_rad - robot.guard.position_overrun_rad;
  params.position_max_rad = joint.position_max_rad + robot.guard.position_overrun_rad;
  params.target_min_rad = joint.position_min_rad;
  params.target_max_rad = joint.position_max_rad;
  params.soft_start_s = robot.guard.soft_start_s;
  params.joint = {joint.sign, joint.zero_rad, joint.ratio};
  return params;
}

std::unique_ptr<Drive> make_drive(const robot::RobotConfig& robot, const robot::JointConfig& joint) {
  return std::make_unique<Cia402Drive>(params_of(robot, joint));
}

std::string look(const robot::RobotConfig& robot, const robot::DeviceConfig& device, const AskedBus& line) {
  const auto joint = std::ranges::find_if(
      robot.joints, [&](const robot::JointConfig& each) { return &robot.devices[each.device] == &device; });
  if (joint == robot.joints.end()) return "";
  const DriverParams params = params_of(robot, *joint);
  canopen::SdoClient client(device.id);
  Setup setup(params);
  setup.begin(client, true);
  canopen::converse(
      line, device.id, [&](std::int64_t now_ns, Frame& frame) { return setup.next(now_ns, client, frame); },
      [&](const Frame& frame) { return client.on_frame(frame); },
      [&] { return setup.advance(client) != Setup::Progress::busy; });
  return told(setup.not_ready(), setup.lacking(setup.lacks(), setup.not_ready().address.index), params);
}

std::unique_ptr<BusMaster> make_master(const robot::RobotConfig& robot, std::size_t bus) {
  const Together all = together_on(robot, bus);
  return std::make_unique<canopen::CanopenMaster>(
      canopen::MasterParams{.heartbeat_s = all.watchdog_s / canopen::kHeartbeatsPerWatchdog, .divider = all.divider});
}

PlannedFrames planned_frames(const robot::DeviceConfig& device, const robot::BusConfig& /*bus*/) {
  const double rate = 1.0 / device.rate_divider;
  return {{.what = "command",
           .size = pdo::command_map(device.keys.cia402.mode).bytes(),
           .id = pdo::command_id(device.id),
           .outbound = true,
           .per_tick = rate},
          {.what = "velocity",
           .size = pdo::velocity_map().bytes(),
           .id = pdo::transmit_id(pdo::kVelocity, device.id),
           .per_tick = rate},
          {.what = "answer",
           .size = pdo::answer_map().bytes(),
           .id = pdo::transmit_id(pdo::kAnswer, device.id),
           .per_tick = rate},
          {.what = "heartbeat",
           .size = 1,
           .id = canopen::cob::kHeartbeat + device.id,
           .per_s = 1 / DriverParams{}.heartbeat_s}};
}

PlannedFrames bus_frames(const robot::RobotConfig& robot, std::size_t bus) {
  const Together all = together_on(robot, bus);
  return {{.what = "SYNC", .id = canopen::cob::kSync, .outbound = true, .per_tick = 1.0 / all.divider},
          {.what = "heartbeat",
           .size = 1,
           .id = canopen::cob::kHeartbeat + canopen::cob::kNode,
           .outbound = true,
           .per_s = canopen::kHeartbeatsPerWatchdog / all.watchdog_s}};
}

std::string state_words(std::uint32_t state, std::uint32_t error_class) {
  std::string words(state_name(static_cast<State>(state)));
  if (error_class == 0) return words;
  if (error_class == kUnnamedClass) return words + ": it does not say why";
  const auto code = static_cast<std::uint16_t>(error_class << 8);
  return fmt::format("{}: {} ({:02x}xxh)", words, canopen::emergency_name(code), error_class);
}

bool process_map(const robot::DeviceConfig& device, std::uint32_t id, canopen::PdoMap& map) {
  if (id == pdo::command_id(device.id))
    map = pdo::command_map(device.keys.cia402.mode);
  else if (id == pdo::transmit_id(pdo::kAnswer, device.id))
    map = pdo::answer_map();
  else if (id == pdo::transmit_id(pdo::kVelocity, device.id))
    map = pdo::velocity_map();
  else
    return false;
  return true;
}

std::string process_value(const canopen::Mapped& mapped, std::uint32_t raw) {
  const std::uint16_t index = mapped.address.index;
  if (index == object::kControlword) return control_text(raw);
  if (index == object::kStatusword) {
    State state{};
    return decode_state(static_cast<std::uint16_t>(raw), state) ? std::string(state_name(state))
                                                                : fmt::format("status {:04x}h", raw);
  }
  const bool thousandths = index == object::kTargetTorque || index == object::kTorque || index == object::kTorqueOffset;
  return fmt::format("{} {}{}", object_name(index), canopen::signed_of(raw, mapped.bytes), thousandths ? "/1000" : "");
}

std::string_view object_name(std::uint16_t index) { return canopen::name_in(kObjects, index); }

}  // namespace lithe::hal::cia402
