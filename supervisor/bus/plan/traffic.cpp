// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/plan/plan.hpp"

#include <algorithm>
#include <random>

#include "spine/hal/registry.hpp"
#include "supervisor/bus/plan/frame_time.hpp"

namespace lithe::bus {
namespace {

using hal::Frame;
using hal::PlannedFrame;
using hal::PlannedFrames;
using robot::BusConfig;

constexpr std::uint32_t kSamples = 64;

Frame sample_of(const PlannedFrame& kind, std::uint32_t number, std::mt19937& random) {
  Frame frame;
  frame.id = kind.id_of(number);
  frame.extended = frame.id > 0x7ff;
  frame.fd = frame.brs = kind.fd;
  frame.size = static_cast<std::uint8_t>(kind.size);
  for (std::uint8_t& byte : frame.data) byte = static_cast<std::uint8_t>(random());
  return frame;
}

void add_text(const Frame& frame, const hal::BusType& bus, Traffic& traffic) {
  if (bus.text_bytes == nullptr) return;
  (traffic.outbound ? traffic.text_out_bytes : traffic.text_in_bytes) = bus.text_bytes(frame, traffic.outbound);
  if (traffic.outbound) traffic.text_in_bytes = bus.echo_bytes;
}

Traffic cost(const PlannedFrame& kind, const BusConfig& bus, Detail detail) {
  Traffic traffic{kind};
  const hal::BusType& type = hal::type_of(bus.kind);
  if (type.transfer_us != nullptr) traffic.spi_us = type.transfer_us(kind.size, kind.outbound);
  if (!kind.on_bus) return traffic;
  const hal::BitRates rates{bus.bitrate, std::max(bus.bitrate, bus.data_bitrate)};
  std::mt19937 random(1);
  const std::uint32_t samples = detail == Detail::all ? kSamples : 1;
  for (std::uint32_t i = 0; i < samples; ++i) {
    const Frame frame = sample_of(kind, i, random);
    traffic.extended = frame.extended;
    traffic.average_us += 1e-3 * static_cast<double>(hal::duration_ns(hal::exact_bits(frame), rates)) / samples;
    traffic.worst_us = 1e-3 * static_cast<double>(hal::duration_ns(hal::most_bits(hal::shape_of(frame)), rates));
    add_text(frame, type, traffic);
  }
  return traffic;
}

std::vector<Traffic> costs(const PlannedFrames& frames, const BusConfig& bus, Detail detail) {
  std::vector<Traffic> all;
  for (const PlannedFrame& each : frames) all.push_back(cost(each, bus, detail));
  return all;
}

}  // namespace

std::vector<Traffic> traffic_of(const robot::DeviceConfig& device, const BusConfig& bus, Detail detail) {
  return costs(hal::type_of(device.kind).frames(device, bus), bus, detail);
}

std::vector<Traffic> shared_traffic(const robot::RobotConfig& robot, std::size_t bus, Detail detail) {
  for (const robot::DeviceConfig& device : robot.devices) {
    const auto frames = hal::type_of(device.kind).bus_frames;
    if (device.bus == bus && frames != nullptr) return costs(frames(robot, bus), robot.buses[bus], detail);
  }
  return {};
}

}  // namespace lithe::bus
