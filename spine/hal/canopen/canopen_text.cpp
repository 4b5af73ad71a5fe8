// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/canopen/canopen_text.hpp"

#include <fmt/format.h>

#include <iterator>

#include "spine/hal/canopen/canopen_sdo.hpp"

namespace lithe::hal::canopen {
namespace {

constexpr Names kEmergencies[] = {
    {emergency::kOverCurrent, "over-current"},
    {emergency::kOverVoltage, "over-voltage"},
    {emergency::kUnderVoltage, "under-voltage"},
    {emergency::kTooHot, "too hot"},
    {emergency::kSensor, "sensor"},
    {emergency::kHeartbeatLost, "heartbeat lost"},
    {emergency::kPdoTooShort, "process data too short"},
    {emergency::kFollowingError, "following error"},
};
// By the uppermost digit, from 1.
constexpr std::string_view kClasses[] = {
    "generic", "current", "voltage", "temperature", "hardware", "software", "additional modules", "monitoring"};
constexpr Names kStates[] = {{static_cast<std::uint32_t>(NmtState::boot_up), "boot-up"},
                             {static_cast<std::uint32_t>(NmtState::stopped), "stopped"},
                             {static_cast<std::uint32_t>(NmtState::operational), "operational"},
                             {static_cast<std::uint32_t>(NmtState::pre_operational), "pre-operational"}};
constexpr Names kCommands[] = {{static_cast<std::uint32_t>(NmtCommand::start), "start"},
                               {static_cast<std::uint32_t>(NmtCommand::stop), "stop"},
                               {static_cast<std::uint32_t>(NmtCommand::enter_pre_operational), "enter pre-operational"},
                               {static_cast<std::uint32_t>(NmtCommand::reset_node), "reset node"},
                               {static_cast<std::uint32_t>(NmtCommand::reset_communication), "reset communication"}};

constexpr Names kObjects[] = {
    {object::kDeviceType, "device type"},
    {object::kErrorRegister, "error register"},
    {object::kDeviceName, "device name"},
    {object::kConsumerHeartbeat, "consumer heartbeat"},
    {object::kProducerHeartbeatMs, "producer heartbeat ms"},
    {object::kIdentity, "identity"},
};

std::string_view object_name(std::uint16_t index, const FrameContext& context) {
  const std::string_view common = name_in(kObjects, index);
  return common.empty() ? context.object_name(index) : common;
}

std::string object_text(Address address, const FrameContext& context) {
  const std::string number = fmt::format("{:04x}h:{}", address.index, address.subindex);
  const std::string_view name = object_name(address.index, context);
  return name.empty() ? number : fmt::format("{} {}", number, name);
}

std::string pdo_text(const Frame& frame, const FrameContext& context) {
  const std::uint32_t function = function_of(frame);
  const bool to_node = (function & 0x80) == 0;
  const std::string which = fmt::format("{}{} ", to_node ? "RPDO" : "TPDO",
                                        (function - (to_node ? cob::kRpdo1 : cob::kTpdo1)) / cob::kNextPdo + 1);
  const std::string values = context.process_data(frame);
  return which + (values.empty() ? bytes_text(frame) : values);
}

std::string sdo_text(const Frame& frame, bool request, const FrameContext& context) {
  if (frame.size != 8) return "SDO of a wrong length: " + bytes_text(frame);
  const std::uint8_t command = frame.data[0];
  const std::uint32_t value = little_endian(frame.data.data() + 4, 4);
  const std::string object = object_text(sdo_address(frame), context);
  const std::size_t bytes = sdo_expedited_bytes(command);
  const auto number = [&] { return little_endian(frame.data.data() + 4, bytes); };
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
      return fmt::format("SDO abort {}: {} ({:08x}h)", object, abort_name(value), value);
    default:
      return "SDO " + bytes_text(frame);
  }
}

std::string emergency_text(const Frame& frame) {
  Emergency what;
  if (!parse_emergency(frame, what)) return "emergency, malformed: " + bytes_text(frame);
  if (what.code == emergency::kGone) return "emergency: errors are over";
  return fmt::format("emergency {:04x}h {}, error register {:02x}h", what.code, emergency_name(what.code),
                     what.error_register);
}

std::string heartbeat_text(const Frame& frame) {
  NmtState state{};
  if (!parse_heartbeat(frame, state)) return "heartbeat, malformed: " + bytes_text(frame);
  return fmt::format("heartbeat: {}", word(state));
}

std::string nmt_text(const Frame& frame) {
  if (frame.size != 2) return "NMT, malformed: " + bytes_text(frame);
  const std::string who = frame.data[1] == 0 ? "all nodes" : fmt::format("node {}", frame.data[1]);
  return fmt::format("NMT {}: {}", word(static_cast<NmtCommand>(frame.data[0])), who);
}

}  // namespace

std::string_view emergency_name(std::uint16_t code) {
  const std::size_t first = code >> 12;
  return name_in(kEmergencies, code, first - 1 < std::size(kClasses) ? kClasses[first - 1] : "of the maker's own");
}

std::string_view word(NmtState state) { return name_in(kStates, static_cast<std::uint32_t>(state), "no known state"); }

std::string_view word(NmtCommand command) {
  return name_in(kCommands, static_cast<std::uint32_t>(command), "no known command");
}

FrameText frame_text(const Frame& frame, const FrameContext& context) {
  if (!is_canopen(frame)) return {false, std::nullopt, "no CANopen: " + bytes_text(frame)};
  const std::uint32_t node = node_of(frame);
  const std::uint32_t function = function_of(frame);
  if (frame.id == cob::kNmt) {
    FrameText decoded{true, std::nullopt, nmt_text(frame)};
    if (frame.size == 2 && frame.data[1] != 0) decoded.device = frame.data[1];
    return decoded;
  }
  if (frame.id == cob::kSync) return {true, std::nullopt, "SYNC"};
  if (node == 0) return {false, std::nullopt, "of no node: " + bytes_text(frame)};
  if (function == cob::kEmergency) return {false, node, emergency_text(frame)};
  if (function == cob::kHeartbeat) return {node == cob::kNode, node, heartbeat_text(frame)};
  if (function == cob::kSdoAnswer) return {false, node, sdo_text(frame, false, context)};
  if (function == cob::kSdoRequest) return {true, node, sdo_text(frame, true, context)};
  if (function >= cob::kTpdo1 && function < cob::kSdoAnswer)
    return {(function & 0x80) == 0, node, pdo_text(frame, context)};
  return {false, node, bytes_text(frame)};
}

}  // namespace lithe::hal::canopen
