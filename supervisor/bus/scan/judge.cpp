// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/scan/scan.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>

#include "spine/hal/registry.hpp"

namespace lithe::bus {
namespace {

using robot::DeviceKind;

// Of a CANopen device: the kind that the file says; else that of its profile; else the first one, which it does not
// fit.
const hal::DeviceType& type_of_found(const robot::RobotConfig& robot, std::size_t bus, DeviceKind first,
                                     const hal::FoundDevice& found) {
  if (hal::type_of(first).profile == 0) return hal::type_of(first);
  for (const robot::DeviceConfig& device : robot.devices) {
    const hal::DeviceType& type = hal::type_of(device.kind);
    if (device.bus == bus && device.id == found.id && type.profile != 0) return type;
  }
  for (const hal::DeviceType& type : hal::device_types())
    if (type.profile != 0 && found.profile == type.profile) return type;
  return hal::type_of(first);
}

Judged judge_device(const hal::FoundDevice& found, const hal::DeviceType& type) {
  Judged device{type.kind, found.id, "", Standing::present, found.what, ""};
  const bool fits = !found.profile || *found.profile == type.profile;
  if (!found.twice.empty()) {
    device.standing = Standing::twice;
    device.advice = found.twice;
  } else if (!found.unfit.empty() || !fits) {
    device.standing = Standing::unfit;
    device.advice = found.unfit.empty() ? std::string(type.unfit) : found.unfit;
  }
  return device;
}

// A device of the file gets its name; any other device is `unknown`.
void compare(const robot::RobotConfig& robot, std::size_t bus, std::vector<Judged>& all) {
  for (Judged& found : all) {
    for (const robot::DeviceConfig& device : robot.devices)
      if (device.bus == bus && device.kind == found.kind && device.id == found.id) found.name = device.name;
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
    if (!on_it || std::ranges::any_of(all, is_it)) continue;
    all.push_back({device.kind, device.id, device.name, Standing::missing, "", ""});
  }
}

const Judged* unknown_of_kind(const std::vector<Judged>& all, DeviceKind kind) {
  const auto found = std::ranges::find_if(
      all, [kind](const Judged& each) { return each.kind == kind && each.standing == Standing::unknown; });
  return found == all.end() ? nullptr : &*found;
}

void advise(const std::string& file, std::vector<Judged>& all) {
  const bool silence = std::ranges::all_of(all, [](const Judged& e) { return e.standing == Standing::missing; });
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

BusFindings judge(const robot::RobotConfig& robot, std::size_t bus, bool from_file, const Line& line) {
  BusFindings findings{bus, {}, "", ""};
  const bool asked = line.error.empty() && line.commander.empty();
  for (const Line::KindScanner& each : line.scanners)
    for (const hal::FoundDevice& found : each.scanner->found(asked))
      findings.devices.push_back(judge_device(found, type_of_found(robot, bus, each.kind, found)));
  if (!line.commander.empty()) {
    findings.error = "another program commands this bus (" + line.commander +
                     " was heard), so nothing was asked; end that program, or watch it: lithe bus monitor";
  }
  if (!line.error.empty()) findings.error = line.error;
  if (!from_file) return findings;
  compare(robot, bus, findings.devices);
  // A device that could not be asked is not called missing: the bus has the error.
  if (line.error.empty()) add_missing(robot, bus, findings.devices);
  advise(robot.path, findings.devices);
  return findings;
}

bool matches(const BusFindings& findings) {
  return findings.error.empty() && std::ranges::all_of(findings.devices, [](const Judged& e) {
           return e.standing == Standing::expected || e.standing == Standing::present;
         });
}

}  // namespace lithe::bus
