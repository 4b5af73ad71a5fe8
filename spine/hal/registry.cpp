// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/registry.hpp"

#include <array>
#include <cmath>
#include <utility>

#include "spine/hal/bus/fdcanusb/fdcanusb_bus.hpp"
#include "spine/hal/bus/fdcanusb/fdcanusb_codec.hpp"
#include "spine/hal/bus/fdcanusb/sim_fdcanusb.hpp"
#include "spine/hal/bus/serial/serial_port.hpp"
#include "spine/hal/bus/slcan/sim_slcan.hpp"
#include "spine/hal/bus/slcan/slcan_bus.hpp"
#include "spine/hal/bus/slcan/slcan_codec.hpp"
#include "spine/hal/bus/socketcan/socketcan_bus.hpp"
#include "spine/hal/cia401/cia401.hpp"
#include "spine/hal/cia401/cia401_type.hpp"
#include "spine/hal/cia401/sim/sim_cia401.hpp"
#include "spine/hal/cia402/cia402.hpp"
#include "spine/hal/cia402/cia402_type.hpp"
#include "spine/hal/cia402/sim/make_sim_cia402.hpp"
#include "spine/hal/gateway/gateway_type.hpp"
#include "spine/hal/gateway/sim/sim_gateway.hpp"
#include "spine/hal/moteus/moteus_type.hpp"
#include "spine/hal/moteus/sim/make_sim_moteus.hpp"

namespace lithe::hal {
namespace {

using robot::BusKind;
using robot::DeviceKind;

template <class Made>
Result<std::unique_ptr<Bus>> as_bus(const robot::BusConfig& config, Result<std::unique_ptr<Made>> made) {
  if (!made) return Error{"bus '" + config.name + "': " + made.message()};
  return std::unique_ptr<Bus>(std::move(*made));
}

Checksums checksums_of(robot::Checksums wanted) {
  if (wanted == robot::Checksums::automatic) return Checksums::by_device;
  return wanted == robot::Checksums::on ? Checksums::on : Checksums::off;
}

std::int64_t wait_ns(const robot::BusConfig& config) { return std::llround(1e9 * config.reply_wait_s); }
std::uint32_t baud_of(const robot::BusConfig& config) { return config.baud == 0 ? kUsualBaud : config.baud; }

Result<std::unique_ptr<Bus>> open_fdcanusb(const robot::BusConfig& config) {
  return as_bus(config, FdcanusbBus::open({.path = config.path,
                                           .checksums = checksums_of(config.checksums),
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

template <class Adapter>
std::unique_ptr<sim::SimAdapter> make_adapter() {
  return std::make_unique<Adapter>();
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

std::unique_ptr<SensorDevice> make_imu(const robot::DeviceConfig& device, ImuSource* board) {
  return std::make_unique<BoardImu>(board, std::llround(1e9 * device.watchdog_s));
}

std::unique_ptr<BusNode> make_sim_gateway(const sim::SimPlace& place) {
  constexpr std::int64_t kPeriodNs = 1'000'000;
  return std::make_unique<sim::SimGateway>(place.device.id, kPeriodNs, robot::is_fd(place.bus));
}

// The IMU of a board is on no bus: its driver simulates it.
class Nobody final : public BusNode {
 public:
  void on_frame(const Frame& /*frame*/, std::int64_t /*now_ns*/, FrameQueue& /*answers*/) LITHE_RT override {}
};

std::unique_ptr<BusNode> make_nobody(const sim::SimPlace& /*place*/) { return std::make_unique<Nobody>(); }

PlannedFrames imu_frames(const robot::DeviceConfig& /*device*/, const robot::BusConfig& /*bus*/) {
  return {{.what = "attitude", .size = 4 * kImuChannels + 2, .per_tick = 1, .on_bus = false}};
}

constexpr std::uint32_t kOfDrives = bit_of(InjectedFault::power_loss) | bit_of(InjectedFault::over_temperature) |
                                    bit_of(InjectedFault::encoder_lost) | bit_of(InjectedFault::device_fault) |
                                    bit_of(InjectedFault::watchdog_trip) | bit_of(InjectedFault::other_map);

constexpr std::array<DeviceType, robot::kDeviceFacts.size()> kDevices{{
    {.kind = DeviceKind::moteus,
     .make_drive = moteus::make_drive,
     .make_sim = sim::make_sim_moteus,
     .couple = sim::couple_moteus,
     .motor_torque_max_nm = sim::moteus_torque_max_nm,
     .injected = kOfDrives | bit_of(InjectedFault::homing_lost),
     .frames = moteus::planned_frames,
     .state_words = moteus::state_words},
    {.kind = DeviceKind::cia402,
     .make_drive = cia402::make_drive,
     .make_master = cia402::make_master,
     .make_sim = sim::make_sim_cia402,
     .couple = sim::couple_cia402,
     .motor_torque_max_nm = sim::cia402_torque_max_nm,
     .injected = kOfDrives,
     .frames = cia402::planned_frames,
     .bus_frames = cia402::bus_frames,
     .profile = cia402::kDeviceProfile,
     .unfit = "it is no CiA 402 drive, and cannot be driven as one",
     .state_words = cia402::state_words,
     .process_map = cia402::process_map,
     .process_value = cia402::process_value,
     .object_name = cia402::object_name},
    {.kind = DeviceKind::gateway,
     .make_sensors = gateway::make_gateway,
     .make_sim = make_sim_gateway,
     .injected = bit_of(InjectedFault::power_loss) | bit_of(InjectedFault::other_map),
     .frames = gateway::planned_frames},
    {.kind = DeviceKind::imu, .make_on_board = make_imu, .make_sim = make_nobody, .frames = imu_frames},
    {.kind = DeviceKind::cia401,
     .make_sensors = cia401::make_module,
     .make_sim = sim::make_sim_cia401,
     .injected = bit_of(InjectedFault::power_loss) | bit_of(InjectedFault::other_map),
     .frames = cia401::planned_frames,
     .profile = cia401::kDeviceProfile,
     .unfit = "it is no CiA 401 module, and cannot be read as one",
     .process_map = cia401::process_map,
     .process_value = cia401::process_value,
     .object_name = cia401::object_name},
}};

constexpr std::array<BusType, robot::kBusFacts.size()> kBuses{{
    {.kind = BusKind::loop, .adapter = "fdcanusb", .make_adapter = make_adapter<sim::SimFdcanusb>},
    {.kind = BusKind::fdcanusb,
     .open = open_fdcanusb,
     .adapter = "fdcanusb",
     .make_adapter = make_adapter<sim::SimFdcanusb>,
     .text_bytes = fdcanusb_bytes,
     .echo_bytes = 4},  // OK and its line end
    {.kind = BusKind::slcan,
     .open = open_slcan,
     .adapter = "slcan",
     .make_adapter = make_adapter<sim::SimSlcan>,
     .text_bytes = slcan_bytes,
     .echo_bytes = 2},
    {.kind = BusKind::socketcan, .open = open_socketcan, .adapter = "socketcan"},
    {.kind = BusKind::pi3hat, .adapter = "fdcanusb", .make_adapter = make_adapter<sim::SimFdcanusb>},
}};

static_assert(robot::in_order(kDevices) && robot::in_order(kBuses));

}  // namespace

const DeviceType& type_of(robot::DeviceKind kind) { return kDevices[static_cast<std::size_t>(kind)]; }
const BusType& type_of(robot::BusKind kind) { return kBuses[static_cast<std::size_t>(kind)]; }
std::span<const DeviceType> device_types() { return kDevices; }

}  // namespace lithe::hal
