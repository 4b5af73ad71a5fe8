// SPDX-License-Identifier: Apache-2.0
#include "spine/info.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "spine/arena/layout.hpp"
#include "spine/core/host/realtime.hpp"
#include "spine/robot/values.hpp"

namespace lithe {
namespace {

template <std::size_t N>
void put_text(std::array<char, N>& to, const std::string& text, std::size_t at = 0, std::size_t room = N) {
  const std::size_t length = std::min({text.size(), room - 1, N - at - 1});
  std::copy_n(text.data(), length, to.data() + at);
}

}  // namespace

std::string describe_host(const std::vector<std::string>& known) {
  std::string notes;
  const auto add = [&notes](const std::string& sentence) { notes += (notes.empty() ? "" : "; ") + sentence; };
  for (const std::string& note : known) add(note);
  if (const Result<> locked = lock_memory(); !locked) add(locked.message());
  if (const int nice_value = raise_priority(); nice_value > -20)
    add("priority stays at nice " + std::to_string(nice_value) + ": run as root, or set LimitNICE=-20");
  return notes;
}

void write_robot_info(ipc::ChannelMemory<wire::RobotInfo>& memory, const robot::RobotConfig& robot,
                      const robot::CpuPlan& cpus, const std::string& notes, const Own& own) {
  auto info = std::make_unique<wire::RobotInfo>();
  put_text(info->robot, robot.name);
  put_text(info->config_path, robot.path);
  put_text(info->notes, notes);
  info->values_hash = robot::values_hash(robot.values);
  info->rate_hz = robot.rate_hz;
  info->joint_count = static_cast<std::uint32_t>(robot.joints.size());
  info->cpu_spine = static_cast<std::uint32_t>(cpus.spine);
  info->cpu_transport = static_cast<std::uint32_t>(cpus.transport);
  info->cpu_brain = static_cast<std::uint32_t>(cpus.brain);
  info->cpu_housekeeping = static_cast<std::uint32_t>(cpus.housekeeping);
  info->tid_spine = static_cast<std::uint32_t>(own.tid_spine);
  info->protection_keys = own.protection_keys ? 1 : 0;
  if (own.code_arena) {
    info->arena_base = arena::kBase;
    info->arena_slots = arena::kSlots;
    info->arena_slot_bytes = arena::kSlotBytes;
  }
  info->transport_inline = cpus.transport_inline ? 1 : 0;
  for (std::size_t j = 0; j < robot.joints.size(); ++j) {
    const robot::JointConfig& joint = robot.joints[j];
    put_text(info->joint_name, joint.name, 32 * j, 32);
    put_text(info->joint_group, joint.group, 32 * j, 32);
    info->position_min_rad[j] = joint.position_min_rad;
    info->position_max_rad[j] = joint.position_max_rad;
    info->velocity_max_rad_s[j] = joint.velocity_max_rad_s;
    info->torque_max_nm[j] = joint.torque_max_nm;
    info->torque_slew_nm_s[j] = joint.torque_slew_nm_s;
    info->deceleration_rad_s2[j] = joint.deceleration_rad_s2;
  }
  info->sensor_count = static_cast<std::uint32_t>(robot.sensors.size());
  for (std::size_t i = 0; i < robot.sensors.size(); ++i) put_text(info->sensor_name, robot.sensors[i].name, 32 * i, 32);
  info->input_count = static_cast<std::uint32_t>(robot.inputs.size());
  for (std::size_t i = 0; i < robot.inputs.size(); ++i) {
    put_text(info->input_name, robot.inputs[i].name, 32 * i, 32);
    info->input_min[i] = robot.inputs[i].min;
    info->input_max[i] = robot.inputs[i].max;
    info->input_value[i] = robot.inputs[i].value;
  }
  ipc::ChannelWriter<wire::RobotInfo>(memory).write(*info);
}

std::string describe_replies(const hal::Actuators& actuators) {
  std::string words;
  const hal::ReplyCounters& n = actuators.counters();
  if (n.missed + n.late + n.duplicate + n.stray + n.malformed + n.unsound + n.refused > 0) {
    words = fmt::format(
        "answers of drives: {} missed, {} late, {} doubled, {} stray, {} malformed; commands: {} not finite, {} "
        "refused "
        "by a full bus",
        n.missed, n.late, n.duplicate, n.stray, n.malformed, n.unsound, n.refused);
  }
  const std::string buses = actuators.tell_buses();
  return words + (words.empty() || buses.empty() ? "" : "; ") + buses;
}

std::string ready_line(const robot::RobotConfig& robot, const robot::CpuPlan& cpus, const std::string& notes) {
  const nlohmann::json line = {{"event", "ready"},
                               {"robot", robot.name},
                               {"pid", getpid()},
                               {"rate_hz", robot.rate_hz},
                               {"joints", robot.joints.size()},
                               {"cpus",
                                {{"spine", cpus.spine},
                                 {"transport", cpus.transport},
                                 {"brain", cpus.brain},
                                 {"housekeeping", cpus.housekeeping},
                                 {"transport_inline", cpus.transport_inline}}},
                               {"notes", notes}};
  return line.dump();
}

}  // namespace lithe
