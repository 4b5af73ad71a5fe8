// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/gateway/gateway_type.hpp"

#include <cmath>

#include "spine/hal/gateway/gateway.hpp"

namespace lithe::hal::gateway {
namespace {

constexpr double kFramesPerS = 2000;

}  // namespace

std::unique_ptr<SensorDevice> make_gateway(const robot::DeviceConfig& device) {
  return std::make_unique<Gateway>(device.id, std::llround(1e9 * device.watchdog_s));
}

PlannedFrames planned_frames(const robot::DeviceConfig& device, const robot::BusConfig& bus) {
  const bool fd = is_fd(bus);
  const auto block = [&](const char* what, std::size_t size, double per_s) {
    return PlannedFrame{
        .what = what, .size = size, .id = kIdBase | device.id << 8, .fd = fd, .per_s = per_s, .unasked = true};
  };
  if (!fd) return {block("inputs", 8, kFramesPerS)};
  return {block("analog", fd_size(4 + 2 * kChannels), kFramesPerS / 2), block("digital", 8, kFramesPerS / 2)};
}

}  // namespace lithe::hal::gateway
