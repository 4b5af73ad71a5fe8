// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/registry.hpp"

#include <array>
#include <cmath>
#include <utility>

#include "spine/hal/bus/fdcanusb/fdcanusb_bus.hpp"
#include "spine/hal/bus/fdcanusb/fdcanusb_codec.hpp"
#include "spine/hal/bus/pi3hat/pi3hat_type.hpp"
#include "spine/hal/bus/serial/serial_port.hpp"
#include "spine/hal/bus/slcan/slcan_bus.hpp"
#include "spine/hal/bus/slcan/slcan_codec.hpp"
#include "spine/hal/bus/socketcan/socketcan_bus.hpp"
#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/canopen/canopen_text.hpp"
#include "spine/hal/cia401/cia401.hpp"
#include "spine/hal/cia401/cia401_module.hpp"
#include "spine/hal/cia402/cia402.hpp"
#include "spine/hal/cia402/cia402_drive.hpp"
#include "spine/hal/gateway/gateway.hpp"
#include "spine/hal/moteus/moteus.hpp"

namespace lithe::hal {
namespace {

using robot::BusKind;
using robot::DeviceKind;

template <class Made>
Result<std::unique_ptr<Bus>> as_bus(const robot::BusConfig& config, Result<std::unique_ptr<Made>> made) {
  if (!made) return Error{"bus '" + config.name + "': " + made.message()};
  return std::unique_ptr<Bus>(std::move(*made));
}

std::int64_t wait_ns(const robot::BusConfig& config) { return std::llround(1e9 * config.reply_wait_s); }
std::uint32_t baud_of(const robot::BusConfig& config) { return config.baud == 0 ? kUsualBaud : config.baud; }

Result<std::unique_ptr<Bus>> open_fdcanusb(const robot::BusConfig& config) {
  return as_bus(config, FdcanusbBus::open({.path = config.path,
                                           .checksums = config.keys.fdcanusb.checksums,
                                           .reply_wait_ns = wait_ns(config),
                                           .baud = baud_of(config)}));
}

Result<std::unique_ptr<Bus>> open_slcan(const robot::BusConfig& config) {
  return as_bus(config, SlcanBus::open({.path = config.path,
                                        .bitrate = config.bitrate,
                                        .data_bitrate = config.data_bitrate,
                                        .reply_wait_ns = wait_ns(config),
                                        .baud = baud_of(config)}));
}

Result<std::unique_ptr<Bus>> open_socketcan(const robot::BusConfig& config) {
  return as_bus(config, SocketCanBus::open({.interface = config.interface,
                                            .bitrate = config.bitrate,
                                            .data_bitrate = config.data_bitrate,
                                            .reply_wait_ns = wait_ns(config)}));
}

double fdcanusb_bytes(const Frame& frame, bool outbound) {
  std::array<char, fdcanusb::kLongestLine> line{};
  constexpr std::size_t kLineEnd = 2;
  return static_cast<double>(outbound ? fdcanusb::format_send(frame, true, line)
                                      : fdcanusb::format_received(frame, line) + kLineEnd);
}

double slcan_bytes(const Frame& frame, bool /*outbound*/) {
  return 1 + (frame.extended ? 8 : 3) + 1 + 2.0 * frame.size + 1;  // letter, id, length, data, end
}

std::unique_ptr<SensorDevice> make_imu(const robot::DeviceConfig& device, ImuSource& board) {
  return std::make_unique<BoardImu>(board, std::llround(1e9 * device.watchdog_s));
}

PlannedFrames imu_frames(const robot::DeviceConfig& /*device*/, const robot::BusConfig& /*bus*/) {
  return {{.what = "attitude", .size = 4 * kImuChannels + 2, .per_tick = 1, .on_bus = false}};
}

constexpr std::array<DeviceType, robot::kDeviceFacts.size()> kDevices{{
    {.kind = DeviceKind::moteus,
     .make_drive = moteus::make_drive,
     .frames = moteus::planned_frames,
     .sender_of = moteus::device_of,
     .make_scanner = moteus::make_scanner,
     .frame_text = moteus::frame_text,
     .state_words = moteus::state_words},
    {.kind = DeviceKind::cia402,
     .make_drive = cia402::make_drive,
     .make_master = cia402::make_master,
     .frames = cia402::planned_frames,
     .bus_frames = cia402::bus_frames,
     .sender_of = canopen::sender_of,
     .make_scanner = canopen::make_scanner,
     .frame_text = canopen::frame_text,
     .look = cia402::look,
     .profile = cia402::kDeviceProfile,
     .unfit = "it is no CiA 402 drive, and cannot be driven as one",
     .state_words = cia402::state_words,
     .process_map = cia402::process_map,
     .process_value = cia402::process_value,
     .object_name = cia402::object_name},
    {.kind = DeviceKind::gateway,
     .make_sensors = gateway::make_gateway,
     .frames = gateway::planned_frames,
     .is_own = gateway::is_gateway,
     .make_scanner = gateway::make_scanner,
     .frame_text = gateway::frame_text},
    {.kind = DeviceKind::imu, .make_on_board = make_imu, .frames = imu_frames},
    {.kind = DeviceKind::cia401,
     .make_sensors = cia401::make_module,
     .frames = cia401::planned_frames,
     .sender_of = canopen::sender_of,
     .make_scanner = canopen::make_scanner,
     .frame_text = canopen::frame_text,
     .look = cia401::look,
     .profile = cia401::kDeviceProfile,
     .unfit = "it is no CiA 401 module, and cannot be read as one",
     .process_map = cia401::process_map,
     .process_value = cia401::process_value,
     .object_name = cia401::object_name},
}};

constexpr std::array<BusType, robot::kBusFacts.size()> kBuses{{
    {.kind = BusKind::loop},
    {.kind = BusKind::fdcanusb,
     .open = open_fdcanusb,
     .text_bytes = fdcanusb_bytes,
     .echo_bytes = 4},  // OK and its line end
    {.kind = BusKind::slcan, .open = open_slcan, .text_bytes = slcan_bytes, .echo_bytes = 2},
    {.kind = BusKind::socketcan, .open = open_socketcan},
    {.kind = BusKind::pi3hat,
     .open_board = pi3hat::open_board,
     .processors = pi3hat::kProcessors,
     .processor_of = pi3hat::processor_of,
     .transfer_us = pi3hat::transfer_us,
     .poll_us = pi3hat::poll_us},
}};

static_assert(robot::in_order(kDevices) && robot::in_order(kBuses));

}  // namespace

const DeviceType& type_of(robot::DeviceKind kind) { return kDevices[static_cast<std::size_t>(kind)]; }
const BusType& type_of(robot::BusKind kind) { return kBuses[static_cast<std::size_t>(kind)]; }
std::span<const DeviceType> device_types() { return kDevices; }
std::span<const BusType> bus_types() { return kBuses; }

}  // namespace lithe::hal
