// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia401/cia401_type.hpp"

#include <cmath>

#include "spine/hal/cia401/cia401_module.hpp"

namespace lithe::hal::cia401 {
std::unique_ptr<SensorDevice> make_module(const robot::DeviceConfig& device) {
  ModuleParams params;
  params.id = device.id;
  params.inputs = device.keys.cia401.inputs;
  params.send_every_s = device.keys.cia401.send_every_s;
  params.stale_ns = std::llround(1e9 * device.watchdog_s);
  return std::make_unique<Module>(params);
}

PlannedFrames planned_frames(const robot::DeviceConfig& device, const robot::BusConfig& /*bus*/) {
  PlannedFrames frames;
  for (std::size_t number = 0; number < kPdos; ++number) {
    const std::size_t bytes = pdo_map(number, device.keys.cia401.inputs).bytes();
    if (bytes == 0) continue;
    frames.push_back({.what = number == 0 ? "digital" : "analog",
                      .size = bytes,
                      .id = pdo_id(number, device.id),
                      .per_s = 1 / device.keys.cia401.send_every_s,
                      .unasked = true});
  }
  frames.push_back({.what = "heartbeat",
                    .size = 1,
                    .id = canopen::cob::kHeartbeat + device.id,
                    .per_s = 1 / ModuleParams{}.heartbeat_s});
  return frames;
}

bool process_map(const robot::DeviceConfig& device, std::uint32_t id, canopen::PdoMap& map) {
  for (std::size_t number = 0; number < kPdos; ++number) {
    if (id != pdo_id(number, device.id)) continue;
    map = pdo_map(number, device.keys.cia401.inputs);
    return !map.objects().empty();
  }
  return false;
}

// For example "digital 0-7 00000101", with input 0 last; "analog 3 -120".
std::string process_value(const canopen::Mapped& mapped, std::uint32_t raw) {
  const std::uint32_t first = mapped.address.subindex - 1U;
  if (mapped.address.index == object::kAnalogInputs)
    return "analog " + std::to_string(first) + " " + std::to_string(canopen::signed_of(raw, mapped.bytes));
  std::string bits;
  for (int bit = 7; bit >= 0; --bit) bits += (raw >> bit & 1) != 0 ? '1' : '0';
  return "digital " + std::to_string(8 * first) + "-" + std::to_string(8 * first + 7) + " " + bits;
}

std::string_view object_name(std::uint16_t index) {
  switch (index) {
    case object::kDigitalInputs:
      return "digital inputs";
    case object::kAnalogInputs:
      return "analog inputs";
    case object::kAnalogInterrupt:
      return "analog inputs are sent";
    default:
      return {};
  }
}

}  // namespace lithe::hal::cia401
