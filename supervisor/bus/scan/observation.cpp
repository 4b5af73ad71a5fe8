// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/scan/observation.hpp"

#include "spine/hal/gateway/gateway.hpp"

namespace lithe::bus {
namespace {

namespace canopen = hal::canopen;
namespace gateway = hal::gateway;

constexpr std::uint32_t kMoteusPart = 0xffff;  // of an id: source and destination; the rest is a prefix
constexpr std::uint32_t kReplyRequested = 0x8000;

// A moteus sends only answers. So a frame of that form is a question or an answer of another program.
std::string moteus_commander(const hal::Frame& frame) {
  if (!frame.fd) return "";
  const std::uint32_t source = frame.id >> 8 & 0x7f;
  if ((frame.id & kReplyRequested) != 0) return "a command from address " + std::to_string(source);
  if (frame.id > kMoteusPart) return "";
  return "a frame from address " + std::to_string(source) + " that we did not ask for";
}

std::string canopen_commander(const hal::Frame& frame) {
  if (!canopen::is_canopen(frame)) return "";
  const std::uint32_t function = canopen::function_of(frame);
  if (frame.id == canopen::cob::kNmt) return "a network command (NMT)";
  if (frame.id == canopen::cob::kSync) return "SYNC";
  if (function == canopen::cob::kSdoRequest) return "an SDO request";
  const bool rpdo = function >= canopen::cob::kRpdo1 && function < canopen::cob::kSdoAnswer &&
                    (function - canopen::cob::kRpdo1) % canopen::cob::kNextPdo == 0;
  return rpdo ? "process data for node " + std::to_string(canopen::node_of(frame)) : "";
}

void observe_node(const hal::Frame& frame, BusObservation& observed) {
  canopen::NmtState state{};
  if (!canopen::is_canopen(frame) || canopen::node_of(frame) == 0) return;
  if (canopen::function_of(frame) == canopen::cob::kHeartbeat && canopen::parse_heartbeat(frame, state)) {
    observed.nodes[canopen::node_of(frame)].heartbeat = state;
  }
}

}  // namespace

Protocol protocol_of(const robot::RobotConfig& robot, std::size_t bus) {
  for (const robot::DeviceConfig& device : robot.devices) {
    const Protocol protocol = robot::facts(device.kind).protocol;
    if (device.bus == bus && protocol != Protocol::own) return protocol;
  }
  return robot::is_fd(robot.buses[bus]) ? Protocol::moteus : Protocol::canopen;
}

void observe(const hal::Frame& frame, Protocol protocol, BusObservation& observed) {
  ++observed.frames;
  if (gateway::is_gateway(frame)) {
    ObservedGateway& one = observed.gateways[gateway::node_of(frame)];
    ++one.frames;
    const std::uint32_t block = frame.id & 0xff;
    if (block < gateway::kBlocks) one.blocks |= 1U << block;
    return;
  }
  if (protocol == Protocol::canopen) observe_node(frame, observed);
  if (!observed.commander.empty()) return;
  observed.commander = protocol == Protocol::moteus    ? moteus_commander(frame)
                       : protocol == Protocol::canopen ? canopen_commander(frame)
                                                       : "";
}

}  // namespace lithe::bus
