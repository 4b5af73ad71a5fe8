// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/monitor/decode.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <utility>
#include <vector>

#include "spine/hal/canopen/canopen_pdo.hpp"
#include "spine/hal/canopen/canopen_words.hpp"
#include "spine/hal/gateway/gateway.hpp"
#include "spine/hal/registry.hpp"
#include "supervisor/bus/words.hpp"

namespace lithe::bus {
namespace {

namespace canopen = hal::canopen;
namespace cob = hal::canopen::cob;

constexpr std::pair<std::uint16_t, const char*> kObjects[] = {
    {canopen::object::kDeviceType, "device type"},
    {canopen::object::kErrorRegister, "error register"},
    {canopen::object::kDeviceName, "device name"},
    {canopen::object::kConsumerHeartbeat, "consumer heartbeat"},
    {canopen::object::kProducerHeartbeatMs, "producer heartbeat ms"},
    {canopen::object::kIdentity, "identity"},
};

// Of the communication profile, or of a kind of device; empty = unknown.
std::string_view object_name(std::uint16_t index) {
  const auto* const found =
      std::find_if(std::begin(kObjects), std::end(kObjects), [index](const auto& each) { return each.first == index; });
  if (found != std::end(kObjects)) return found->second;
  for (const hal::DeviceType& type : hal::device_types()) {
    const std::string_view name = type.object_name != nullptr ? type.object_name(index) : std::string_view();
    if (!name.empty()) return name;
  }
  return {};
}

std::string object_text(canopen::Address address) {
  const std::string number = fmt::format("{:04x}h:{}", address.index, address.subindex);
  const std::string_view name = object_name(address.index);
  return name.empty() ? number : fmt::format("{} {}", number, name);
}

std::string bytes_text(const hal::Frame& frame) {
  std::string text;
  for (const std::uint8_t byte : frame.payload()) text += fmt::format("{}{:02x}", text.empty() ? "" : " ", byte);
  return text.empty() ? "no data" : text;
}

std::string process_text(const hal::DeviceType& type, const canopen::PdoMap& map, const hal::Frame& frame) {
  std::array<std::uint32_t, canopen::PdoMap::kMost> values{};
  if (!map.unpack(frame, values)) return "shorter than it is mapped: " + bytes_text(frame);
  std::string text;
  for (std::size_t i = 0; i < map.objects().size(); ++i) {
    text += (text.empty() ? "" : ", ") + type.process_value(map.objects()[i], values[i]);
  }
  return text;
}

std::string pdo_text(const hal::Frame& frame, const robot::RobotConfig& robot, std::size_t bus) {
  const std::uint32_t node = canopen::node_of(frame);
  const std::uint32_t function = canopen::function_of(frame);
  const bool to_node = (function & 0x80) == 0;
  const std::string which = fmt::format("{}{} ", to_node ? "RPDO" : "TPDO",
                                        (function - (to_node ? cob::kRpdo1 : cob::kTpdo1)) / cob::kNextPdo + 1);
  for (const robot::DeviceConfig& device : robot.devices) {
    const hal::DeviceType& type = hal::type_of(device.kind);
    if (device.bus != bus || device.id != node || type.process_map == nullptr) continue;
    canopen::PdoMap map;
    if (type.process_map(device, frame.id, map)) return which + process_text(type, map, frame);
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
  return fmt::format("emergency {:04x}h {}, error register {:02x}h", what.code, canopen::emergency_name(what.code),
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

}  // namespace lithe::bus
