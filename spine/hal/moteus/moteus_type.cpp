// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/moteus/moteus_type.hpp"

#include <array>
#include <span>

#include "spine/hal/moteus/moteus.hpp"
#include "spine/hal/moteus/moteus_codec.hpp"
#include "spine/hal/moteus/moteus_faults.hpp"

namespace lithe::hal::moteus {
namespace {

// The length of the answer follows from the registers that the command reads.
std::size_t answer_size(const Frame& command) {
  Frame answer;
  SubframeWriter writer(answer);
  SubframeReader reader(command.payload());
  Subframe subframe;
  constexpr std::array<double, kMaxPayload> kZeros{};
  while (reader.next(subframe)) {
    if (subframe.kind != Kind::read || subframe.count > kZeros.size()) continue;
    writer.reply(subframe.format, subframe.start, std::span(kZeros).first(subframe.count), subframe.long_form);
  }
  writer.pad();
  return answer.size;
}

void use_frames(const FrameKeys& frames, DriverParams& params) {
  const Format all = frames.command;
  params.command = {all, all, all, all, all, all, params.command.watchdog};
  params.answer = {frames.answer, frames.answer, frames.answer, frames.current, frames.power};
  params.settings_in_drive = frames.settings_in_drive;
}

}  // namespace

std::unique_ptr<Drive> make_drive(const robot::RobotConfig& robot, const robot::JointConfig& joint) {
  const robot::DeviceConfig& device = robot.devices[joint.device];
  DriverParams params;
  params.id = device.id;
  params.watchdog_s = device.watchdog_s;
  params.joint = {joint.sign, joint.zero_rad, joint.ratio};
  params.damp_kd_nm_s_rad = joint.safe_kd_nm_s_rad;
  params.damp_torque_max_nm = joint.torque_max_nm / joint.ratio;
  params.velocity_max_rad_s = joint.velocity_max_rad_s;
  params.torque_step_nm = joint.torque_slew_nm_s * device.rate_divider / robot.rate_hz;
  params.may_hold_alone = device.keys.moteus.may_hold_alone;
  params.ask_settings = true;
  params.kp_max_nm_rad = joint.kp_max_nm_rad;
  params.kd_max_nm_s_rad = joint.kd_max_nm_s_rad;
  use_frames(device.keys.moteus.frames, params);
  return std::make_unique<MoteusDrive>(params);
}

PlannedFrames planned_frames(const robot::DeviceConfig& device, const robot::BusConfig& /*bus*/) {
  DriverParams params;
  params.id = device.id;
  params.watchdog_s = device.watchdog_s;
  use_frames(device.keys.moteus.frames, params);
  const MoteusDrive driver(params);
  JointCommand command;
  command.action = DriveAction::torque;  // the longest
  Frame frame;
  driver.encode(command, 0, frame);
  const double rate = 1.0 / device.rate_divider;
  // Our source address, in every second value from 0 to 126, is bits 8 to 14 of a command and 0 to 6 of an answer.
  return {{.what = "command",
           .size = frame.size,
           .id = 0x8000 | device.id,
           .fd = true,
           .outbound = true,
           .per_tick = rate,
           .id_step = 0x200,
           .id_wrap = 0x8000},
          {.what = "answer",
           .size = answer_size(frame),
           .id = device.id << 8,
           .fd = true,
           .per_tick = rate,
           .id_step = 2,
           .id_wrap = 0x80}};
}

std::string state_words(std::uint32_t mode, std::uint32_t code) {
  std::string words = mode_name(static_cast<Mode>(mode));
  if (code == 0) return words;
  if (is_limit(code)) words += ", at its limit";
  return words + ": " + fault_name(code) + " (" + std::to_string(code) + ")";
}

}  // namespace lithe::hal::moteus
