// SPDX-License-Identifier: Apache-2.0
// What is known about a bus so far, from listening and asking.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/core/frame.hpp"
#include "spine/hal/moteus/moteus_terminal.hpp"
#include "spine/robot/config.hpp"

namespace lithe::bus {

// In which the devices of a bus are asked. moteus and CANopen devices cannot share one, so that a question in the one
// never reaches devices of the other.
using robot::Protocol;

struct ObservedMoteus {
  hal::moteus::Found found;
  std::optional<hal::moteus::Identity> identity;
  std::string why_unknown;  // why the identity is unknown
};

struct ObservedNode {
  std::uint32_t answers = 0;  // to one question for object 1000h; 2 = two nodes with this id
  std::optional<hal::canopen::NmtState> heartbeat;
  std::optional<std::uint32_t> device_type;  // 1000h: the profile is its low half
  std::optional<std::uint32_t> vendor, product, revision, serial;
  std::string name;
};

struct ObservedGateway {
  std::uint64_t frames = 0;
  std::uint32_t blocks = 0;  // bit of gateway::Block
};

struct BusObservation {
  std::vector<ObservedMoteus> moteus;  // in order of their ids
  std::map<std::uint32_t, ObservedNode> nodes;
  std::map<std::uint32_t, ObservedGateway> gateways;
  std::string commander;  // evidence that another program commands this bus; empty = none
  std::string trouble;    // the bus error that kept devices from being asked; empty = none
  std::uint64_t frames = 0;
};

// The protocol of the file's devices on this bus. Without a file: moteus on CAN FD, CANopen on classic CAN.
Protocol protocol_of(const robot::RobotConfig& robot, std::size_t bus);

// Records a frame that was not an answer to us.
// Contract: any frame is safe
void observe(const hal::Frame& frame, Protocol protocol, BusObservation& observed);

}  // namespace lithe::bus
