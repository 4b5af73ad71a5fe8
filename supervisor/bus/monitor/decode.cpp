// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/monitor/decode.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <utility>
#include <vector>

#include "spine/hal/canopen/canopen_pdo.hpp"
#include "spine/hal/cia402/cia402_setup.hpp"
#include "spine/hal/gateway/gateway.hpp"
#include "supervisor/bus/drive_words.hpp"
#include "supervisor/bus/state_words.hpp"

namespace lithe::field {
namespace {

namespace canopen = hal::canopen;
namespace cia402 = hal::cia402;
namespace cob = hal::canopen::cob;

constexpr std::pair<std::uint16_t, const char*> kObjects[] = {
    {canopen::object::kDeviceType, "device type"},
    {canopen::object::kErrorRegister, "error register"},
    {canopen::object::kDeviceName, "device name"},
    {canopen::object::kConsumerHeartbeat, "consumer heartbeat"},
    {canopen::object::kProducerHeartbeatMs, "producer heartbeat ms"},
    {canopen::object::kIdentity, "identity"},
    {cia402::object::kAbortConnection, "abort connection"},
    {cia402::object::kErrorCode, "error code"},
    {cia402::object::kControlword, "control"},
    {cia402::object::kStatusword, "status"},
    {cia402::object::kQuickStopOption, "quick stop option"},
    {cia402::object::kMode, "mode"},
    {cia402::object::kModeDisplay, "mode display"},
    {cia402::object::kPosition, "position"},
    {cia402::object::kVelocity, "velocity"},
    {cia402::object::kTargetTorque, "target torque"},
    {cia402::object::kMaxTorque, "most torque"},
    {cia402::object::kRatedTorque, "rated torque mNm"},
    {cia402::object::kTorque, "torque"},
    {cia402::object::kTargetPosition, "target position"},
    {cia402::object::kTorqueOffset, "torque offset"},
    {cia402::object::kTargetVelocity, "target velocity"},
    {cia402::object::kSupportedModes, "supported modes"},
};

std::string object_text(canopen::Address address) {
  const std::string number = fmt::format("{:04x}h:{}", address.index, address.subindex);
  const auto* const found = std::find_if(std::begin(kObjects), std::end(kObjects),
                                         [&](const auto& each) { return each.first == address.index; });
  return found == std::end(kObjects) ? number : number + " " + found->second;
}

std::string bytes_text(const hal::Frame& frame) {
  std::string text;
  for (const std::uint8_t byte : frame.payload()) text += fmt::format("{}{:02x}", text.empty() ? "" : " ", byte);
  return text.empty() ? "no data" : text;
}

std::string control_text(std::uint32_t word) {
  if ((word & cia402::control::kFaultReset) != 0) return "fault reset";
  if ((word & 0x02) == 0) return "disable voltage";
  if ((word & 0x04) == 0) return "quick stop";
  if ((word & 0x01) == 0) return "shutdown";
  return (word & 0x08) != 0 ? "enable" : "switch on";
}

std::string mapped_text(const canopen::Mapped& mapped, std::uint32_t raw) {
  const std::uint16_t index = mapped.address.index;
  if (index == cia402::object::kControlword) return control_text(raw);
  if (index == cia402::object::kStatusword) {
    cia402::State state{};
    return cia402::decode_state(static_cast<std::uint16_t>(raw), state) ? std::string(cia402::state_name(state))
                                                                        : fmt::format("status {:04x}h", raw);
  }
  const auto* const found =
      std::find_if(std::begin(kObjects), std::end(kObjects), [index](const auto& each) { return each.first == index; });
  const std::string name = found == std::end(kObjects) ? fmt::format("{:04x}h", index) : found->second;
  const bool thousandths = index == cia402::object::kTargetTorque || index == cia402::object::kTorque ||
                           index == cia402::object::kTorqueOffset;
  return fmt::format("{} {}{}", name, canopen::signed_of(raw, mapped.bytes), thousandths ? "/1000" : "");
}

std::string process_text(const canopen::PdoMap& map, const hal::Frame& frame) {
  std::array<std::uint32_t, canopen::PdoMap::kMost> values{};
  if (!map.unpack(frame, values)) return "shorter than it is mapped: " + bytes_text(frame);
  std::string text;
  for (std::size_t i = 0; i < map.objects().size(); ++i) {
    text += (text.empty() ? "" : ", ") + mapped_text(map.objects()[i], values[i]);
  }
  return text;
}

cia402::Mode mode_of(robot::DriveMode mode) {
  if (mode == robot::DriveMode::torque) return cia402::Mode::torque;
  return mode == robot::DriveMode::position ? cia402::Mode::position : cia402::Mode::velocity;
}

std::string pdo_text(const hal::Frame& frame, const robot::RobotConfig& robot, std::size_t bus) {
  const std::uint32_t node = canopen::node_of(frame);
  const std::uint32_t function = canopen::function_of(frame);
  const bool to_node = (function & 0x80) == 0;
  const std::string which = fmt::format("{}{} ", to_node ? "RPDO" : "TPDO",
                                        (function - (to_node ? cob::kRpdo1 : cob::kTpdo1)) / cob::kNextPdo + 1);
  for (const robot::DeviceConfig& device : robot.devices) {
    if (device.bus != bus || device.kind != robot::DeviceKind::cia402 || device.id != node) continue;
    if (frame.id == cia402::pdo::command_id(node))
      return which + process_text(cia402::pdo::command_map(mode_of(device.mode)), frame);
    if (frame.id == cia402::pdo::transmit_id(cia402::pdo::kAnswer, node))
      return which + process_text(cia402::pdo::answer_map(), frame);
    if (frame.id == cia402::pdo::transmit_id(cia402::pdo::kVelocity, node))
      return which + process_text(cia402::pdo::velocity_map(), frame);
  }
  return which + bytes_text(frame);
}

std::string sdo_text(const hal::Frame& frame, bool request) {
  if (frame.size != 8) return "SDO of a wrong length: " + bytes_text(frame);
  const std::uint8_t command = frame.data[0];
  const std::uint32_t value = canopen::get(frame.data.data() + 4, 4);
  const std::string object = object_text(canopen::sdo_address(frame));
  const std::size_t bytes = canopen::sdo_expedited_bytes(command);
  const auto number = [&] { return canopen::get(frame.data.data() + 4, bytes); };
  switch (command >> 5) {
    case 0:
      return request ? "SDO segment to write: " + bytes_text(frame) : "SDO segment: " + bytes_text(frame);
    case 1:
      if (!request) return "SDO segment written";
      return (command & 0x02) != 0 ? fmt::format("SDO write {} = {}", object, number())
                                   : fmt::format("SDO write {}: {} bytes, in segments", object, value);
    case 2:
      if (request) return "SDO read " + object;
      return (command & 0x02) != 0 ? fmt::format("SDO {} = {}", object, number())
                                   : fmt::format("SDO {} has {} bytes, in segments", object, value);
    case 3:
      return request ? "SDO next segment" : "SDO written " + object;
    case 4:
      return fmt::format("SDO abort {}: {} ({:08x}h)", object, canopen::abort_name(value), value);
    default:
      return "SDO " + bytes_text(frame);
  }
}

std::string emergency_text(const hal::Frame& frame) {
  canopen::Emergency what;
  if (!canopen::parse_emergency(frame, what)) return "emergency, malformed: " + bytes_text(frame);
  if (what.code == canopen::emergency::kGone) return "emergency: errors are over";
  return fmt::format("emergency {:04x}h {}, error register {:02x}h", what.code, bus::emergency_name(what.code),
                     what.error_register);
}

std::string heartbeat_text(const hal::Frame& frame) {
  canopen::NmtState state{};
  if (!canopen::parse_heartbeat(frame, state)) return "heartbeat, malformed: " + bytes_text(frame);
  return fmt::format("heartbeat: {}", word(state));
}

std::string nmt_text(const hal::Frame& frame) {
  if (frame.size != 2) return "NMT, malformed: " + bytes_text(frame);
  const std::string who = frame.data[1] == 0 ? "all nodes" : fmt::format("node {}", frame.data[1]);
  return fmt::format("NMT {}: {}", word(static_cast<canopen::NmtCommand>(frame.data[0])), who);
}

}  // namespace

Decoded decode_canopen(const hal::Frame& frame, const robot::RobotConfig& robot, std::size_t bus) {
  if (!canopen::is_canopen(frame)) return {false, std::nullopt, "no CANopen: " + bytes_text(frame)};
  const std::uint32_t node = canopen::node_of(frame);
  const std::uint32_t function = canopen::function_of(frame);
  if (frame.id == cob::kNmt) {
    Decoded decoded{true, std::nullopt, nmt_text(frame)};
    if (frame.size == 2 && frame.data[1] != 0) decoded.device = frame.data[1];
    return decoded;
  }
  if (frame.id == cob::kSync) return {true, std::nullopt, "SYNC"};
  if (node == 0) return {false, std::nullopt, "of no node: " + bytes_text(frame)};
  if (function == cob::kEmergency) return {false, node, emergency_text(frame)};
  if (function == cob::kHeartbeat) return {node == cob::kNode, node, heartbeat_text(frame)};
  if (function == cob::kSdoAnswer) return {false, node, sdo_text(frame, false)};
  if (function == cob::kSdoRequest) return {true, node, sdo_text(frame, true)};
  if (function >= cob::kTpdo1 && function < cob::kSdoAnswer) {
    return {(function & 0x80) == 0, node, pdo_text(frame, robot, bus)};
  }
  return {false, node, bytes_text(frame)};
}

Decoded decode_gateway(const hal::Frame& frame) {
  namespace gateway = hal::gateway;
  constexpr std::array kBlocks{"analog", "digital", "imu"};
  constexpr std::size_t kHeader = 4;
  Decoded decoded{false, gateway::node_of(frame), ""};
  const std::uint32_t block = frame.id & 0xff;
  const auto bytes = frame.payload();
  if (block >= kBlocks.size() || bytes.size() < kHeader + 2) {
    decoded.text = "gateway, malformed: " + bytes_text(frame);
    return decoded;
  }
  const auto word_at = [&](std::size_t at) { return static_cast<std::uint16_t>(bytes[at] | bytes[at + 1] << 8); };
  decoded.text = fmt::format("{} #{} at {:.1f} ms:", kBlocks[block], bytes[0], 0.1 * word_at(2));
  if (block == static_cast<std::uint32_t>(gateway::Block::digital)) {
    const std::uint16_t valid = bytes.size() >= kHeader + 4 ? word_at(kHeader + 2) : 0;
    decoded.text += fmt::format(" {:016b}, valid {:016b}", word_at(kHeader), valid);
    return decoded;
  }
  for (std::size_t at = kHeader; at + 1 < bytes.size(); at += 2) {
    const std::size_t channel = bytes[1] + (at - kHeader) / 2;
    if (channel >= gateway::kChannels) break;
    const auto raw = static_cast<std::int16_t>(word_at(at));
    decoded.text += raw == gateway::kInvalid ? fmt::format(" {}=-", channel) : fmt::format(" {}={}", channel, raw);
  }
  return decoded;
}

Decoded decode(const hal::Frame& frame, Protocol protocol, const robot::RobotConfig& robot, std::size_t bus) {
  if (hal::gateway::is_gateway(frame)) return decode_gateway(frame);
  return protocol == Protocol::canopen ? decode_canopen(frame, robot, bus) : decode_moteus(frame);
}

}  // namespace lithe::field
