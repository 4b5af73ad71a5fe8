// SPDX-License-Identifier: Apache-2.0
// The kinds of buses and devices: one row each with what must be known of a kind without its driver. Drivers, simulations
// and tools are in the rows of spine/hal/registry.hpp; the keys that only one kind has are in device_keys.cpp.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string_view>

namespace lithe::robot {

enum class BusKind { loop, fdcanusb, slcan, socketcan, pi3hat };
enum class DeviceKind { moteus, cia402, gateway, imu, cia401 };
enum class SensorKind { analog, digital, imu };

// Whose identifiers the devices of a bus use. Two protocols cannot share a bus; `own` goes with either.
enum class Protocol : std::uint8_t { own, moteus, canopen };

// What the robot file names the hardware of a bus by.
enum class PlaceKey : std::uint8_t { none, path, interface, connector };
inline constexpr std::array<std::string_view, 4> kPlaceKeys{"", "path", "interface", "connector"};

struct BusFacts {
  BusKind kind;
  std::string_view word;                   // in the robot file
  bool real = true;                        // false: in memory, with simulated devices
  PlaceKey place = PlaceKey::none;         // `path`: an adapter behind a serial device
  std::uint32_t data_bitrate = 5'000'000;  // unless the file says another; 0 = classic CAN
  bool has_own_rates = false;              // the adapter is not told bit rates
  bool has_checksums = false;              // lines to the adapter may carry them
  bool is_board = false;                   // all buses of this kind are on one board, with an IMU
  bool is_shared = false;                  // every program on the machine hears all its frames
  std::string_view no_classic{};  // why it carries no classic frames while it is FD, and what to do; empty: it does
};

struct Advice {
  std::string_view text{};
  std::string_view next{};  // what to do
};

struct DeviceFacts {
  DeviceKind kind;
  std::string_view word;  // in the robot file
  std::string_view noun;  // for messages
  Protocol protocol = Protocol::own;
  bool drives = false;                  // moves a joint; the others only measure
  bool on_bus = true;                   // has an id; false: it is on a board
  bool asked = true;                    // once in `rate_divider` ticks; false: it sends by its own clock
  bool needs_fd = false;                // its frames are CAN FD
  bool needs_classic = false;           // its frames are classic CAN
  bool is_synced = false;               // one SYNC asks all of a bus, and a command waits for it
  bool tells_home = true;               // a drive that knows whether it is homed
  bool has_frames = false;              // [device.frames] chooses the formats of its numbers
  std::array<std::size_t, 3> inputs{};  // number of channels by SensorKind
  std::string_view other_inputs{};      // the answer to a sensor of a kind that it has no channels of
  double arm_timeout_s = 5;             // time that it may need after power-on until it can be armed
  Advice not_ready{};                   // why a drive that answers cannot be armed; empty: the log says it
};

inline constexpr std::array<BusFacts, 5> kBusFacts{{
    {.kind = BusKind::loop, .word = "loop", .real = false},
    {.kind = BusKind::fdcanusb,
     .word = "fdcanusb",
     .place = PlaceKey::path,
     .has_own_rates = true,
     .has_checksums = true,
     .no_classic = "is an fdcanusb, which sends CAN FD; this device speaks classic CAN: use slcan or socketcan"},
    {.kind = BusKind::slcan, .word = "slcan", .place = PlaceKey::path, .data_bitrate = 0},  // most adapters are classic
    {.kind = BusKind::socketcan, .word = "socketcan", .place = PlaceKey::interface, .is_shared = true},
    {.kind = BusKind::pi3hat,
     .word = "pi3hat",
     .place = PlaceKey::connector,
     .is_board = true,
     .no_classic = "is a connector with CAN FD, which sends nothing else; this device speaks classic CAN: say "
                   "data_bitrate = 0 there"},
}};

inline constexpr std::array<DeviceFacts, 5> kDeviceFacts{{
    {.kind = DeviceKind::moteus,
     .word = "moteus",
     .noun = "a moteus",
     .protocol = Protocol::moteus,
     .drives = true,
     .needs_fd = true,
     .has_frames = true},
    {.kind = DeviceKind::cia402,
     .word = "cia402",
     .noun = "a cia402 drive",
     .protocol = Protocol::canopen,
     .drives = true,
     .needs_classic = true,
     .is_synced = true,
     .tells_home = false,
     .arm_timeout_s = 15,  // powered on late it is reset again after 5 s, and then configured
     .not_ready = {"has no heartbeat (1017h)",
                   "check its power and cable; while it is off it is reset and set up anew "
                   "every 5 s; then: lithe arm"}},
    {.kind = DeviceKind::gateway, .word = "gateway", .noun = "a gateway", .asked = false, .inputs = {16, 16, 10}},
    {.kind = DeviceKind::imu,
     .word = "imu",
     .noun = "an imu",
     .on_bus = false,
     .inputs = {0, 0, 10},
     .other_inputs = "what hangs on an imu has kind = \"imu\": attitude w x y z, angular rate, acceleration"},
    {.kind = DeviceKind::cia401,
     .word = "cia401",
     .noun = "a cia401",
     .protocol = Protocol::canopen,
     .asked = false,
     .needs_classic = true,
     .inputs = {12, 16, 0},
     .other_inputs = "what hangs on a cia401 has kind = \"analog\" or \"digital\""},
}};

// The rows are in the order of the kinds.
constexpr const BusFacts& facts(BusKind kind) { return kBusFacts[static_cast<std::size_t>(kind)]; }
constexpr const DeviceFacts& facts(DeviceKind kind) { return kDeviceFacts[static_cast<std::size_t>(kind)]; }

template <class Rows>
constexpr bool in_order(const Rows& rows) {
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (static_cast<std::size_t>(rows[i].kind) != i) return false;
  }
  return true;
}
static_assert(in_order(kBusFacts) && in_order(kDeviceFacts));

// The word in robot.toml.
constexpr std::string_view word(BusKind kind) { return facts(kind).word; }
constexpr std::string_view word(DeviceKind kind) { return facts(kind).word; }

// True for devices that move a joint; the others only measure.
constexpr bool is_drive(DeviceKind kind) { return facts(kind).drives; }

// True when devices of both kinds may share a bus.
constexpr bool go_together(DeviceKind a, DeviceKind b) {
  const Protocol of_a = facts(a).protocol, of_b = facts(b).protocol;
  return of_a == of_b || of_a == Protocol::own || of_b == Protocol::own;
}

}  // namespace lithe::robot
