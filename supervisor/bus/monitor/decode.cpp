// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/monitor/decode.hpp"

#include <array>
#include <string_view>

#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/canopen/canopen_pdo.hpp"
#include "spine/hal/registry.hpp"

namespace lithe::bus {
namespace {

namespace canopen = hal::canopen;

std::string_view object_name(std::uint16_t index) {
  for (const hal::DeviceType& type : hal::device_types()) {
    const std::string_view name = type.object_name != nullptr ? type.object_name(index) : std::string_view();
    if (!name.empty()) return name;
  }
  return {};
}

std::string process_text(const hal::DeviceType& type, const canopen::PdoMap& map, const hal::Frame& frame) {
  std::array<std::uint32_t, canopen::PdoMap::kMost> values{};
  if (!map.unpack(frame, values)) return "shorter than it is mapped: " + hal::bytes_text(frame);
  std::string text;
  for (std::size_t i = 0; i < map.objects().size(); ++i)
    text += (text.empty() ? "" : ", ") + type.process_value(map.objects()[i], values[i]);
  return text;
}

std::string process_data(const hal::Frame& frame, const robot::RobotConfig& robot, std::size_t bus) {
  for (const robot::DeviceConfig& device : robot.devices) {
    const hal::DeviceType& type = hal::type_of(device.kind);
    if (device.bus != bus || device.id != canopen::node_of(frame) || type.process_map == nullptr) continue;
    canopen::PdoMap map;
    if (type.process_map(device, frame.id, map)) return process_text(type, map, frame);
  }
  return "";
}

}  // namespace

hal::FrameText decode(const hal::Frame& frame, robot::Protocol protocol, const robot::RobotConfig& robot,
                      std::size_t bus) {
  const hal::FrameContext context{[&](const hal::Frame& pdo) { return process_data(pdo, robot, bus); }, object_name};
  const hal::DeviceType* speaks = nullptr;
  for (const hal::DeviceType& type : hal::device_types()) {
    if (type.is_own != nullptr && type.is_own(frame)) return type.frame_text(frame, context);
    if (type.frame_text != nullptr && robot::facts(type.kind).protocol == protocol) speaks = &type;
  }
  return speaks != nullptr ? speaks->frame_text(frame, context) : hal::FrameText{false, {}, hal::bytes_text(frame)};
}

}  // namespace lithe::bus
