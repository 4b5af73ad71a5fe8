// SPDX-License-Identifier: Apache-2.0
// What a bus has told so far, heard or asked for.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "spine/hal/bus/frame.hpp"
#include "spine/hal/device/canopen.hpp"
#include "spine/hal/device/moteus_terminal.hpp"
#include "spine/robot/config.hpp"

namespace lithe::field {

// Which protocol the devices of a bus are asked in. moteus and CANopen devices cannot share one, so that a question in
// the one never reaches devices of the other.
enum class Protocol : std::uint8_t { none, moteus, canopen };

struct MoteusSeen {
  hal::moteus::Found found;
  std::optional<hal::moteus::Identity> identity;
  std::string why_unknown;  // where there is no identity
};

struct NodeSeen {
  std::uint32_t answers = 0;  // to the one question for object 1000h; two: there are two such nodes
  std::optional<hal::canopen::NmtState> heartbeat;
  std::optional<std::uint32_t> device_type;  // 1000h: the profile is its low half
  std::optional<std::uint32_t> vendor, product, revision, serial;
  std::string name;
};

struct GatewaySeen {
  std::uint64_t frames = 0;
  std::uint32_t blocks = 0;  // bit of gateway::Block
};

struct Seen {
  std::vector<MoteusSeen> moteus;  // in order of their ids
  std::map<std::uint32_t, NodeSeen> nodes;
  std::map<std::uint32_t, GatewaySeen> gateways;
  std::string commander;  // the sign that somebody else commands this bus; empty = none
  std::string trouble;    // why not everybody could be asked, as the bus says it; empty = all well
  std::uint64_t frames = 0;
};

// The protocol of the devices that the file puts on the bus; of an unknown bus: CAN FD moteus, classic CAN CANopen.
Protocol protocol_of(const robot::RobotConfig& robot, std::size_t bus);

// Notes a frame that came unasked.
// Contract: any frame whatever
void hear(const hal::Frame& frame, Protocol protocol, Seen& seen);

}  // namespace lithe::field
