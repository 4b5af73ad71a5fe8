// SPDX-License-Identifier: Apache-2.0
// The kinds of devices and buses: one row each with all that differs between them; no other code chooses by kind. What
// the robot file needs is in the rows of spine/robot/kinds.hpp, simulations are in those of
// spine/hal/sim/sim_registry.cpp.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "spine/core/result.hpp"
#include "spine/hal/canopen/canopen_pdo.hpp"
#include "spine/hal/core/board.hpp"
#include "spine/hal/core/bus.hpp"
#include "spine/hal/core/bus_tools.hpp"
#include "spine/hal/core/drive.hpp"
#include "spine/hal/core/sensors.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal {

// A null function: the kind has no such thing.
struct DeviceType {
  robot::DeviceKind kind;

  // Exactly one of these three is set: for a drive, a device with inputs on a bus, inputs of a board.
  std::unique_ptr<Drive> (*make_drive)(const robot::RobotConfig&, const robot::JointConfig&) = nullptr;
  std::unique_ptr<SensorDevice> (*make_sensors)(const robot::DeviceConfig&) = nullptr;
  std::unique_ptr<SensorDevice> (*make_on_board)(const robot::DeviceConfig&, ImuSource& board) = nullptr;
  // For all devices of this kind on a bus that has at least one.
  std::unique_ptr<BusMaster> (*make_master)(const robot::RobotConfig&, std::size_t bus) = nullptr;

  // Planner: the frames of one device, and those that a bus with such devices needs in addition.
  PlannedFrames (*frames)(const robot::DeviceConfig&, const robot::BusConfig&) = nullptr;
  PlannedFrames (*bus_frames)(const robot::RobotConfig&, std::size_t bus) = nullptr;

  // The address of the device that sent a frame, on a bus with its protocol.
  std::uint32_t (*sender_of)(const Frame&) LITHE_RT = nullptr;

  // Scanner and monitor. Kinds with one protocol have the same; `is_own`: true for a frame of this kind on any bus.
  bool (*is_own)(const Frame&) LITHE_RT = nullptr;
  std::unique_ptr<Scanner> (*make_scanner)() = nullptr;
  FrameText (*frame_text)(const Frame&, const FrameContext&) = nullptr;
  // Scanner, of a device of the file that answers: why it would not do, found by reading alone; empty = not known.
  std::string (*look)(const robot::RobotConfig&, const robot::DeviceConfig&, const AskedBus&) = nullptr;
  // Of a CANopen device: the low half of object 1000h.
  std::uint32_t profile = 0;
  std::string_view unfit{};  // advice for a node on its bus with another profile
  // Text for bits 16 to 23 and 8 to 15 of a joint's status.
  std::string (*state_words)(std::uint32_t mode, std::uint32_t code) = nullptr;
  // The map of this process data. False: the device has no such.
  bool (*process_map)(const robot::DeviceConfig&, std::uint32_t id, canopen::PdoMap& map) = nullptr;
  std::string (*process_value)(const canopen::Mapped&, std::uint32_t raw) = nullptr;
  std::string_view (*object_name)(std::uint16_t index) = nullptr;  // empty = not one of its own
};

struct BusType {
  robot::BusKind kind;
  // At most one of these two is set; neither: in memory. A machine has one board, on which all buses of the kind are:
  // BusOpener opens it once, with all buses of the robot. `polled`: for tools.
  Result<std::unique_ptr<Bus>> (*open)(const robot::BusConfig&) = nullptr;
  Result<std::shared_ptr<BusBoard>> (*open_board)(std::span<const robot::BusConfig>, bool polled) = nullptr;

  // Planner, of an adapter: bytes of a frame on the line to it, and of what it answers to each command.
  double (*text_bytes)(const Frame&, bool outbound) = nullptr;
  double echo_bytes = 0;
  // Planner, of a board: its processors, which one a bus is on, and the computer's time for one frame and for one
  // question to a processor. It serves all buses of the board one after the other.
  std::span<const std::string_view> processors{};
  std::size_t (*processor_of)(const robot::BusConfig&) = nullptr;
  double (*transfer_us)(std::size_t size, bool outbound) = nullptr;
  double (*poll_us)(std::span<const robot::BusConfig>) = nullptr;
};

const DeviceType& type_of(robot::DeviceKind kind);
const BusType& type_of(robot::BusKind kind);
std::span<const DeviceType> device_types();
std::span<const BusType> bus_types();

}  // namespace lithe::hal
