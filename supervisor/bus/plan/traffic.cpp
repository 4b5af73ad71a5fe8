// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/plan/traffic.hpp"

#include <algorithm>
#include <array>
#include <functional>
#include <random>

#include "spine/hal/bus/fdcanusb/fdcanusb_codec.hpp"
#include "spine/hal/bus/pi3hat/imu.hpp"
#include "spine/hal/canopen/canopen_master.hpp"
#include "spine/hal/cia402/cia402_setup.hpp"
#include "spine/hal/gateway/gateway.hpp"
#include "spine/hal/moteus/moteus.hpp"
#include "supervisor/bus/plan/frame_time.hpp"

namespace lithe::bus {
namespace {

using hal::Frame;
using robot::BusConfig;
using robot::BusKind;
using robot::DeviceConfig;
using robot::DeviceKind;
using robot::DriveMode;

constexpr std::uint32_t kSamples = 64;
constexpr double kGatewayFramesPerS = 2000;
constexpr double kDriveHeartbeatS = hal::cia402::DriverParams{}.heartbeat_s;

// Time of a pi3hat's SPI transaction: hold times and bytes, header included. The figures are from its host library; the
// result is within 10 % of the published 740 us for twelve servos with 24 bytes out and 16 back.
constexpr double kSpiHoldUs = 9.0;
constexpr double kSpiByteUs = 0.8;
constexpr double kSpiWriteHead = 10;
constexpr double kSpiReadHead = 6;

struct Kind {
  const char* what;
  std::size_t size;
  bool fd;
  bool outbound;
  std::function<std::uint32_t(std::uint32_t sample)> id;
};

struct Line {
  const BusConfig& bus;
  Detail detail;
};

Frame sample_of(const Kind& kind, std::uint32_t number, std::mt19937& random) {
  Frame frame;
  frame.id = kind.id(number);
  frame.extended = frame.id > 0x7ff;
  frame.fd = frame.brs = kind.fd;
  frame.size = static_cast<std::uint8_t>(kind.size);
  for (std::uint8_t& byte : frame.data) byte = static_cast<std::uint8_t>(random());
  return frame;
}

double fdcanusb_bytes(const Frame& frame, bool outbound) {
  std::array<char, hal::fdcanusb::kLongestLine> line{};
  const std::size_t length =
      outbound ? hal::fdcanusb::format_send(frame, true, line) : hal::fdcanusb::format_received(frame, line) + 2;
  return static_cast<double>(length);
}

double slcan_bytes(const Frame& frame) {
  return 1 + (frame.extended ? 8 : 3) + 1 + 2.0 * frame.size + 1;  // letter, id, length, data, end
}

void add_text(const Frame& frame, const BusConfig& bus, Traffic& traffic) {
  if (bus.kind == BusKind::fdcanusb) {
    const double line = fdcanusb_bytes(frame, traffic.outbound);
    (traffic.outbound ? traffic.text_out_bytes : traffic.text_in_bytes) = line;
    if (traffic.outbound) traffic.text_in_bytes = 4;  // OK and its line end
  } else if (bus.kind == BusKind::slcan) {
    (traffic.outbound ? traffic.text_out_bytes : traffic.text_in_bytes) = slcan_bytes(frame);
    if (traffic.outbound) traffic.text_in_bytes = 2;
  }
}

Traffic cost(const Kind& kind, const Line& line, double per_tick, double per_s = 0) {
  const BusConfig& bus = line.bus;
  const hal::BitRates rates{bus.bitrate, std::max(bus.bitrate, bus.data_bitrate)};
  Traffic traffic{kind.what, kind.size, false, kind.fd, kind.outbound, false, per_tick, per_s};
  std::mt19937 random(1);
  const std::uint32_t samples = line.detail == Detail::all ? kSamples : 1;
  for (std::uint32_t i = 0; i < samples; ++i) {
    const Frame frame = sample_of(kind, i, random);
    traffic.extended = frame.extended;
    traffic.average_us += 1e-3 * static_cast<double>(hal::duration_ns(hal::exact_bits(frame), rates)) / samples;
    traffic.worst_us = 1e-3 * static_cast<double>(hal::duration_ns(hal::most_bits(hal::shape_of(frame)), rates));
    add_text(frame, bus, traffic);
  }
  if (bus.kind == BusKind::pi3hat) {
    const double head = kind.outbound ? kSpiWriteHead : kSpiReadHead;
    traffic.spi_us = kSpiHoldUs + kSpiByteUs * (static_cast<double>(kind.size) + head);
  }
  return traffic;
}

// The length of the answer follows from the registers that the command reads.
std::size_t answer_size(const Frame& command) {
  Frame answer;
  hal::moteus::SubframeWriter writer(answer);
  hal::moteus::SubframeReader reader(command.payload());
  hal::moteus::Subframe subframe;
  constexpr std::array<double, hal::kMaxPayload> kZeros{};
  while (reader.next(subframe)) {
    if (subframe.kind != hal::moteus::Kind::read || subframe.count > kZeros.size()) continue;
    writer.reply(subframe.format, subframe.start, std::span(kZeros).first(subframe.count), subframe.long_form);
  }
  writer.pad();
  return answer.size;
}

std::vector<Traffic> moteus_traffic(const DeviceConfig& device, const Line& line) {
  hal::moteus::DriverParams params;
  params.id = device.id;
  params.watchdog_s = device.watchdog_s;
  hal::moteus::use_frames(device.frames, params);
  const hal::moteus::Driver driver(params);
  hal::JointCommand command;
  command.action = hal::DriveAction::torque;  // the longest
  Frame frame;
  driver.encode(command, 0, frame);
  const double rate = 1.0 / device.rate_divider;
  const auto source = [](std::uint32_t i) { return i * 2 % 128; };  // it changes with every exchange
  const Kind ask{"command", frame.size, true, true,
                 [&](std::uint32_t i) { return 0x8000 | source(i) << 8 | device.id; }};
  const Kind answer{"answer", answer_size(frame), true, false,
                    [&](std::uint32_t i) { return device.id << 8 | source(i); }};
  return {cost(ask, line, rate), cost(answer, line, rate)};
}

std::function<std::uint32_t(std::uint32_t)> always(std::uint32_t id) {
  return [id](std::uint32_t) { return id; };
}

hal::cia402::Mode mode_of(DriveMode mode) {
  if (mode == DriveMode::torque) return hal::cia402::Mode::torque;
  return mode == DriveMode::position ? hal::cia402::Mode::position : hal::cia402::Mode::velocity;
}

// It answers to every SYNC, and SYNC comes when its bus's drives are asked, all of them together.
std::vector<Traffic> cia402_traffic(const DeviceConfig& device, const Line& line) {
  namespace pdo = hal::cia402::pdo;
  const Kind command{"command", pdo::command_map(mode_of(device.mode)).bytes(), false, true,
                     always(pdo::command_id(device.id))};
  const Kind velocity{"velocity", pdo::velocity_map().bytes(), false, false,
                      always(pdo::transmit_id(pdo::kVelocity, device.id))};
  const Kind answer{"answer", pdo::answer_map().bytes(), false, false,
                    always(pdo::transmit_id(pdo::kAnswer, device.id))};
  const Kind beat{"heartbeat", 1, false, false, always(hal::canopen::cob::kHeartbeat + device.id)};
  const double rate = 1.0 / device.rate_divider;
  return {cost(command, line, rate), cost(velocity, line, rate), cost(answer, line, rate),
          cost(beat, line, 0, 1 / kDriveHeartbeatS)};
}

// A gateway is not asked, so no rate divider applies: it sends at the rate of the sketch in firmware/, one block after
// the other.
std::vector<Traffic> gateway_traffic(const DeviceConfig& device, const Line& line) {
  const auto block = [&](const char* what, std::size_t size, double per_s) {
    const bool fd = is_fd(line.bus);
    Traffic traffic = cost({what, size, fd, false, always(hal::gateway::kIdBase | device.id << 8)}, line, 0, per_s);
    traffic.unasked = true;
    return traffic;
  };
  if (!is_fd(line.bus)) return {block("inputs", 8, kGatewayFramesPerS)};
  return {block("analog", hal::fd_size(4 + 2 * hal::gateway::kChannels), kGatewayFramesPerS / 2),
          block("digital", 8, kGatewayFramesPerS / 2)};
}

// It is on the board: no bus carries it, SPI does.
std::vector<Traffic> imu_traffic(const Line& line) {
  Traffic traffic;
  traffic.what = "attitude";
  traffic.size = 4 * hal::kImuChannels + 2;
  traffic.per_tick = 1;
  if (line.bus.kind == BusKind::pi3hat) {
    traffic.spi_us = kSpiHoldUs + kSpiByteUs * (static_cast<double>(traffic.size) + kSpiReadHead);
  }
  return {traffic};
}

}  // namespace

std::vector<Traffic> traffic_of(const DeviceConfig& device, const BusConfig& bus, Detail detail) {
  const Line line{bus, detail};
  switch (device.kind) {
    case DeviceKind::moteus:
      return moteus_traffic(device, line);
    case DeviceKind::cia402:
      return cia402_traffic(device, line);
    case DeviceKind::gateway:
      return gateway_traffic(device, line);
    case DeviceKind::imu:
      break;
  }
  return imu_traffic(line);
}

std::vector<Traffic> shared_traffic(const robot::RobotConfig& robot, std::size_t bus, Detail detail) {
  double watchdog_s = 0;
  double rate = 1;
  for (const DeviceConfig& device : robot.devices) {
    if (device.bus != bus || device.kind != DeviceKind::cia402) continue;
    watchdog_s = watchdog_s == 0 ? device.watchdog_s : std::min(watchdog_s, device.watchdog_s);
    rate = 1.0 / device.rate_divider;  // of all of them
  }
  if (watchdog_s == 0) return {};
  namespace cob = hal::canopen::cob;
  const Line line{robot.buses[bus], detail};
  return {cost({"SYNC", 0, false, true, always(cob::kSync)}, line, rate),
          cost({"heartbeat", 1, false, true, always(cob::kHeartbeat + cob::kNode)}, line, 0,
               hal::canopen::kHeartbeatsPerWatchdog / watchdog_s)};
}

}  // namespace lithe::bus
