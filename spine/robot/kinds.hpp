// SPDX-License-Identifier: Apache-2.0
// The kinds of buses and devices: one row each with what must be known of a kind without its driver. Keys that only one
// kind of device has are in its folder; drivers and what tools need are in the rows of spine/hal/registry.hpp.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "spine/hal/bus/fdcanusb/keys/fdcanusb_keys.hpp"
#include "spine/hal/cia401/keys/cia401_keys.hpp"
#include "spine/hal/cia402/keys/cia402_keys.hpp"
#include "spine/hal/moteus/keys/moteus_keys.hpp"

namespace lithe::robot {

enum class BusKind { loop, fdcanusb, slcan, socketcan, pi3hat };
enum class DeviceKind { moteus, cia402, gateway, imu, cia401 };
enum class SensorKind { analog, digital, imu };

// Whose identifiers the devices of a bus use. moteus and canopen cannot share a bus; a device of protocol `own` may
// share one with any other.
enum class Protocol : std::uint8_t { own, moteus, canopen };

// What the robot file names the hardware of a bus by.
enum class PlaceKey : std::uint8_t { none, path, interface, connector };
inline constexpr std::array<std::string_view, 4> kPlaceKeys{"", "path", "interface", "connector"};

// Keys of a [[bus]] that only one kind has. A bus uses those of its own kind.
struct BusKeys {
  hal::fdcanusb::Keys fdcanusb{};
};

struct BusFacts {
  BusKind kind;
  std::string_view word;                   // in the robot file
  bool real = true;                        // false: in memory, with simulated devices
  PlaceKey place = PlaceKey::none;         // `path`: an adapter behind a serial device
  std::uint32_t data_bitrate = 5'000'000;  // unless the file says another; 0 = classic CAN
  std::uint32_t connectors = 0;            // that `connector` counts
  bool has_imu = false;                    // a device that is on no bus can be there
  bool is_shared = false;                  // every program on the machine hears all its frames
  std::string_view own_rates{};   // why the file may not give it other bit rates, and what to do; empty: it may
  std::string_view no_classic{};  // why it carries no classic frames while it is FD, and what to do; empty: it does
  void (*read)(Reader& in, BusKeys& keys) = nullptr;  // its own keys; null: it has none
};

struct Advice {
  std::string_view text{};
  std::string_view next{};  // what to do
};

// Keys of a [[device]] that only one kind has. A device uses those of its own kind.
struct DeviceKeys {
  hal::moteus::Keys moteus{};
  hal::cia402::Keys cia402{};
  hal::cia401::Keys cia401{};
};

// A table of a [[device]] that only one kind may have: [device.KEY].
struct DeviceTable {
  std::string_view key{};
  std::string_view refusal{};  // the answer where another kind has it
  void (*read)(Reader&, DeviceKeys&) = nullptr;
};

using Inputs = std::array<std::size_t, 3>;  // number of channels by SensorKind

// A null function: the kind has no such thing.
struct DeviceFacts {
  DeviceKind kind;
  std::string_view word;  // in the robot file
  std::string_view noun;  // for messages
  Protocol protocol = Protocol::own;
  bool drives = false;              // moves a joint; the others only measure
  bool on_bus = true;               // has an id; false: it is on a board
  bool asked = true;                // once in `rate_divider` ticks; false: it sends by its own clock
  bool needs_fd = false;            // its frames are CAN FD
  bool needs_classic = false;       // its frames are classic CAN
  bool is_synced = false;           // one SYNC asks all of a bus, and a command waits for it
  bool tells_home = true;           // a drive that knows whether it is homed
  Inputs inputs{};                  // at most
  std::string_view other_inputs{};  // the answer to a sensor of a kind that it has no channels of
  double arm_timeout_s = 5;         // time that it may need after power-on until it can be armed
  Advice not_ready{};               // why a drive that answers cannot be armed; empty: the log says it

  // Its own keys. `need`: of those without a default; `watchdog_s`: of the device.
  void (*read)(Reader& in, DeviceKeys& keys, double watchdog_s, Need need) = nullptr;
  DeviceTable table{};
  // Error when the joint needs what its drive cannot do.
  void (*check_joint)(Reader& in, const DeviceKeys& keys, const JointDemand& joint) = nullptr;
  // By its keys; null: `inputs`.
  Inputs (*inputs_in_use)(const DeviceKeys& keys) = nullptr;
  // True for a drive that controls position or velocity itself: a command's torque does not stop it.
  bool (*closes_loop)(const DeviceKeys& keys) = nullptr;
};

inline constexpr std::array<BusFacts, 5> kBusFacts{{
    {.kind = BusKind::loop, .word = "loop", .real = false, .has_imu = true},
    {.kind = BusKind::fdcanusb,
     .word = "fdcanusb",
     .place = PlaceKey::path,
     .own_rates = "an fdcanusb has its bit rates from its own memory, 1000000 and 5000000 from the factory, and is "
                  "not told others; leave it out",
     .no_classic = "is an fdcanusb, which sends CAN FD; this device speaks classic CAN: use slcan or socketcan",
     .read = [](Reader& in, BusKeys& keys) { hal::fdcanusb::read_keys(in, keys.fdcanusb); }},
    {.kind = BusKind::slcan, .word = "slcan", .place = PlaceKey::path, .data_bitrate = 0},  // most adapters are classic
    {.kind = BusKind::socketcan, .word = "socketcan", .place = PlaceKey::interface, .is_shared = true},
    {.kind = BusKind::pi3hat,
     .word = "pi3hat",
     .place = PlaceKey::connector,
     .connectors = 5,
     .has_imu = true,
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
     .read = [](Reader& in, DeviceKeys& keys, double, Need) { hal::moteus::read_keys(in, keys.moteus); },
     .table = {"frames", "only the numbers of a moteus can travel in different formats",
               [](Reader& in, DeviceKeys& keys) { hal::moteus::read_frames(in, keys.moteus.frames); }},
     .check_joint = [](Reader& in, const DeviceKeys& keys,
                       const JointDemand& joint) { hal::moteus::check_joint(in, keys.moteus, joint); }},
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
                   "every 5 s; then: lithe arm"},
     .read = [](Reader& in, DeviceKeys& keys, double, Need need) { hal::cia402::read_keys(in, keys.cia402, need); },
     .check_joint = [](Reader& in, const DeviceKeys& keys,
                       const JointDemand& joint) { hal::cia402::check_joint(in, keys.cia402, joint); },
     .closes_loop = [](const DeviceKeys& keys) { return keys.cia402.mode != hal::cia402::Mode::torque; }},
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
     .inputs = {hal::cia401::kAnalog, hal::cia401::kDigital, 0},
     .other_inputs = "what hangs on a cia401 has kind = \"analog\" or \"digital\"",
     .read = [](Reader& in, DeviceKeys& keys, double watchdog_s,
                Need) { hal::cia401::read_keys(in, keys.cia401, watchdog_s); },
     .inputs_in_use = [](const DeviceKeys& keys) -> Inputs {
       return {keys.cia401.inputs.analog, keys.cia401.inputs.digital, 0};
     }},
}};

// The rows are in the order of the kinds.
constexpr const BusFacts& facts(BusKind kind) { return kBusFacts[static_cast<std::size_t>(kind)]; }
constexpr const DeviceFacts& facts(DeviceKind kind) { return kDeviceFacts[static_cast<std::size_t>(kind)]; }

template <class Rows>
constexpr bool in_order(const Rows& rows) {
  for (std::size_t i = 0; i < rows.size(); ++i)
    if (static_cast<std::size_t>(rows[i].kind) != i) return false;
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
