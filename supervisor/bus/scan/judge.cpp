// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/scan/judge.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <map>

#include "spine/core/text.hpp"
#include "spine/hal/gateway/gateway.hpp"
#include "spine/hal/moteus/moteus_faults.hpp"
#include "spine/hal/registry.hpp"
#include "supervisor/bus/plan/report.hpp"
#include "supervisor/bus/words.hpp"

namespace lithe::bus {
namespace {

using robot::DeviceKind;

std::string uuid_text(const std::array<std::uint8_t, 16>& uuid) {
  std::string text;
  for (std::size_t i = 0; i < uuid.size(); ++i) {
    text += fmt::format("{}{:02x}", i == 4 || i == 6 || i == 8 || i == 10 ? "-" : "", uuid[i]);
  }
  return text;
}

std::string moteus_text(const ObservedMoteus& one) {
  if (!one.identity) return one.why_unknown;
  const hal::moteus::Identity& is = *one.identity;
  std::string text = fmt::format("firmware {}.{}.{}, register map {}, serial {:08x}{:08x}{:08x}, ", is.firmware >> 16,
                                 is.firmware >> 8 & 0xff, is.firmware & 0xff, is.register_map, is.serial[0],
                                 is.serial[1], is.serial[2]);
  const bool has_uuid = one.found.uuid != std::array<std::uint8_t, 16>{};
  text += has_uuid ? "uuid " + uuid_text(one.found.uuid) : "no uuid";
  text += fmt::format(", {}", hal::moteus::mode_name(static_cast<hal::moteus::Mode>(is.mode & 0xff)));
  if (is.fault != 0) text += fmt::format(", {} ({})", hal::moteus::fault_name(is.fault), is.fault);
  return text;
}

std::string node_text(const ObservedNode& node) {
  std::string text;
  const auto add = [&text](const std::string& more) { text += (text.empty() ? "" : ", ") + more; };
  if (!node.name.empty()) add("'" + printable(node.name) + "'");
  if (node.device_type) add(fmt::format("profile {}", *node.device_type & 0xffff));
  if (node.vendor) add(fmt::format("vendor {:08x}h", *node.vendor));
  if (node.product) add(fmt::format("product {:08x}h", *node.product));
  if (node.revision) add(fmt::format("revision {:08x}h", *node.revision));
  if (node.serial) add(fmt::format("serial {:08x}h", *node.serial));
  if (node.heartbeat) add(fmt::format("heartbeat: {}", word(*node.heartbeat)));
  if (node.answers == 0) add("its heartbeat is all that is heard of it");
  return text;
}

std::string gateway_text(const ObservedGateway& observed) {
  std::string blocks;
  constexpr std::array kNames{"analog", "digital", "imu"};
  static_assert(kNames.size() == hal::gateway::kBlocks);
  for (std::size_t i = 0; i < kNames.size(); ++i) {
    if ((observed.blocks >> i & 1) != 0) blocks += fmt::format("{}{}", blocks.empty() ? "" : ", ", kNames[i]);
  }
  return fmt::format("{} frames heard: {}", observed.frames, blocks.empty() ? "no known channels" : blocks);
}

void unfit(Judged& device, const std::string& advice) {
  if (device.standing == Standing::twice) return;
  device.standing = Standing::unfit;
  device.advice = advice;
}

void judge_moteus(const BusObservation& observed, std::vector<Judged>& all) {
  for (const ObservedMoteus& one : observed.moteus) {
    Judged device{DeviceKind::moteus, one.found.id, "", Standing::present, moteus_text(one), ""};
    const auto same_id = [&](const ObservedMoteus& other) { return other.found.id == one.found.id; };
    if (std::count_if(observed.moteus.begin(), observed.moteus.end(), same_id) > 1) {
      device.standing = Standing::twice;
      device.advice = fmt::format(
          "several drives have id {}: leave one of them on the bus, give it an id of its own "
          "(moteus_tool -t {} --console: conf set id.id N, conf write), then plug in the next",
          one.found.id, one.found.id);
    }
    if (one.identity && one.identity->register_map != hal::moteus::kKnownRegisterMap) {
      unfit(device, fmt::format("its firmware has register map {}, and {} is needed: flash another firmware "
                                "(moteus_tool -t {} --flash)",
                                one.identity->register_map, hal::moteus::kKnownRegisterMap, one.found.id));
    }
    all.push_back(std::move(device));
  }
}

// The kind that the file says; else that of its profile; else the first CANopen one, which it does not fit.
const hal::DeviceType& type_of_node(const robot::RobotConfig& robot, std::size_t bus, std::uint32_t id,
                                    const ObservedNode& node) {
  for (const robot::DeviceConfig& device : robot.devices) {
    const hal::DeviceType& type = hal::type_of(device.kind);
    if (device.bus == bus && device.id == id && type.profile != 0) return type;
  }
  const hal::DeviceType* first = nullptr;
  for (const hal::DeviceType& type : hal::device_types()) {
    if (type.profile == 0) continue;
    if (first == nullptr) first = &type;
    if (node.device_type && (*node.device_type & 0xffff) == type.profile) return type;
  }
  return *first;
}

void judge_nodes(const robot::RobotConfig& robot, std::size_t bus, const BusObservation& observed,
                 std::vector<Judged>& all) {
  for (const auto& [id, node] : observed.nodes) {
    const hal::DeviceType& type = type_of_node(robot, bus, id, node);
    Judged device{type.kind, id, "", Standing::present, node_text(node), ""};
    if (node.answers > 1) {
      device.standing = Standing::twice;
      device.advice = fmt::format(
          "{} answers came to one question: several nodes have id {}; take one off the bus and "
          "give it another id (its switches, or its maker's tool)",
          node.answers, id);
    } else if (node.answers == 0 && observed.trouble.empty() && observed.commander.empty()) {
      unfit(device, "it does not answer SDO requests: switch it off and on");
    } else if (node.device_type && (*node.device_type & 0xffff) != type.profile) {
      unfit(device, std::string(type.unfit));
    }
    all.push_back(std::move(device));
  }
}

// A device of the file gets its name; any other device is `unknown`.
void compare(const robot::RobotConfig& robot, std::size_t bus, std::vector<Judged>& all) {
  for (Judged& found : all) {
    for (const robot::DeviceConfig& device : robot.devices) {
      if (device.bus == bus && device.kind == found.kind && device.id == found.id) found.name = device.name;
    }
    if (found.standing == Standing::twice) continue;
    const bool known = !found.name.empty();
    if (known && found.standing == Standing::present) found.standing = Standing::expected;
    if (!known) found.standing = Standing::unknown;
  }
}

void add_missing(const robot::RobotConfig& robot, std::size_t bus, std::vector<Judged>& all) {
  for (const robot::DeviceConfig& device : robot.devices) {
    const auto is_it = [&](const Judged& found) { return found.name == device.name; };
    const bool on_it = device.bus == bus && robot::facts(device.kind).on_bus;
    if (!on_it || std::any_of(all.begin(), all.end(), is_it)) continue;
    all.push_back({device.kind, device.id, device.name, Standing::missing, "", ""});
  }
}

const Judged* unknown_of_kind(const std::vector<Judged>& all, DeviceKind kind) {
  const auto found = std::find_if(all.begin(), all.end(), [kind](const Judged& each) {
    return each.kind == kind && each.standing == Standing::unknown;
  });
  return found == all.end() ? nullptr : &*found;
}

void advise(const std::string& file, std::vector<Judged>& all) {
  const bool silence =
      std::all_of(all.begin(), all.end(), [](const Judged& e) { return e.standing == Standing::missing; });
  for (Judged& each : all) {
    if (each.standing == Standing::unknown) {
      each.advice = fmt::format("add it to {} as a [[device]] of kind \"{}\" with id = {}, or take it off the bus",
                                file, robot::word(each.kind), each.id);
    }
    if (each.standing != Standing::missing) continue;
    const Judged* unknown = unknown_of_kind(all, each.kind);
    if (unknown != nullptr) {
      each.advice = fmt::format("nothing has id {}; if it is the one with id {}, write id = {} in {}", each.id,
                                unknown->id, unknown->id, file);
    } else if (silence) {
      each.advice = "nothing at all is heard on this bus: check power, wires, termination at both ends and bit rates";
    } else {
      each.advice = "others on this bus are there: check its power and its plug, and whether it has another id";
    }
  }
}

}  // namespace

std::string_view word(Standing standing) {
  constexpr std::array<std::string_view, 6> kWords{"expected", "present", "unknown", "missing", "twice", "unfit"};
  return kWords[static_cast<std::size_t>(standing)];
}

BusFindings judge(const robot::RobotConfig& robot, std::size_t bus, bool from_file, const BusObservation& observed) {
  BusFindings findings{bus, {}, "", ""};
  judge_moteus(observed, findings.devices);
  judge_nodes(robot, bus, observed, findings.devices);
  for (const auto& [id, one] : observed.gateways) {
    findings.devices.push_back({DeviceKind::gateway, id, "", Standing::present, gateway_text(one), ""});
  }
  if (!observed.commander.empty()) {
    findings.trouble = "another program commands this bus (" + observed.commander +
                       " was heard), so nothing was asked; end that program, or watch it: lithe bus monitor";
  }
  if (!observed.trouble.empty()) findings.trouble = observed.trouble;
  if (!from_file) return findings;
  compare(robot, bus, findings.devices);
  // A device that could not be asked is not called missing: the bus has the error.
  if (observed.trouble.empty()) add_missing(robot, bus, findings.devices);
  advise(robot.path, findings.devices);
  return findings;
}

bool matches(const BusFindings& findings) {
  return findings.trouble.empty() && std::all_of(findings.devices.begin(), findings.devices.end(), [](const Judged& e) {
           return e.standing == Standing::expected || e.standing == Standing::present;
         });
}

}  // namespace lithe::bus
