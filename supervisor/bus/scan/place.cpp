// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/scan/place.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <filesystem>

#include "spine/hal/registry.hpp"
#include "spine/robot/robot.hpp"
#include "supervisor/bus/plan/plan.hpp"

namespace lithe::bus {
namespace {

using robot::PlaceKey;

// The bus that "KIND:PLACE" names; empty when the text is a file path instead.
std::optional<robot::BusConfig> bus_given(std::string_view what) {
  for (const robot::BusFacts& kind : robot::kBusFacts) {
    const std::string before = std::string(kind.word) + ":";
    if (!kind.real || !what.starts_with(before)) continue;
    robot::BusConfig config;
    config.kind = kind.kind;
    config.data_bitrate = kind.data_bitrate;
    config.name = what;
    const std::string place(what.substr(before.size()));
    if (kind.place == PlaceKey::interface) {
      config.interface = place;
    } else if (kind.place == PlaceKey::connector) {
      config.connector = 0;
      std::from_chars(place.data(), place.data() + place.size(), config.connector);
    } else {
      config.path = place;
    }
    return config;
  }
  return std::nullopt;
}

// The rules of a robot file for bit rates; the error, or empty.
std::string wrong_bitrates(const robot::BusConfig& bus) {
  if (bus.bitrate < robot::kLeastBitrate || bus.bitrate > robot::kMostBitrate) {
    return fmt::format("--bitrate {}: a CAN bus has {} to {} bit/s", bus.bitrate, robot::kLeastBitrate,
                       robot::kMostBitrate);
  }
  if (!robot::is_fd(bus) || (bus.data_bitrate >= bus.bitrate && bus.data_bitrate <= robot::kMostDataBitrate)) return "";
  return fmt::format("--data-bitrate {}: 0 means classic CAN only, else it is {} (as --bitrate) to {} bit/s",
                     bus.data_bitrate, bus.bitrate, robot::kMostDataBitrate);
}

Result<Choice> choose_given(robot::BusConfig bus, const Words& words) {
  if (!words.bus.empty()) return Error{"--bus picks one of a robot file's buses; '" + words.what + "' is one already"};
  if (words.what.ends_with(':')) return Error{words.what + " names no bus; one of: " + bus_forms()};
  const robot::BusFacts& kind = robot::facts(bus.kind);
  if (kind.place == PlaceKey::connector && (bus.connector < 1 || bus.connector > kind.connectors)) {
    return Error{
        fmt::format("{}: a {} has the connectors 1 to {}: {}:1", words.what, kind.word, kind.connectors, kind.word)};
  }
  bus.bitrate = words.bitrate.value_or(bus.bitrate);
  bus.data_bitrate = words.data_bitrate.value_or(bus.data_bitrate);
  if (const std::string wrong = wrong_bitrates(bus); !wrong.empty()) return Error{wrong};
  Choice choice;
  choice.robot.buses.push_back(std::move(bus));
  choice.buses.push_back(0);
  return choice;
}

}  // namespace

Result<Choice> choose(const Words& words) {
  if (auto bus = bus_given(words.what)) return choose_given(std::move(*bus), words);
  if (words.bitrate || words.data_bitrate) return Error{"the bit rates of a robot's buses stand in its file"};
  Result<robot::RobotConfig> robot = robot::load_robot(words.what);
  if (!robot) return Error{robot.message() + "\n(a bus without a robot file: " + bus_forms() + ")"};
  Choice choice;
  choice.from_file = true;
  std::string names;
  for (std::size_t i = 0; i < robot->buses.size(); ++i) {
    const std::string& name = robot->buses[i].name;
    names += (names.empty() ? "" : ", ") + name;
    if (words.bus.empty() || words.bus == name) choice.buses.push_back(i);
  }
  if (choice.buses.empty()) return Error{words.what + ": has no bus '" + words.bus + "'; it has " + names};
  choice.robot = std::move(*robot);
  return choice;
}

std::string bus_forms() {
  constexpr std::array<std::string_view, robot::kPlaceKeys.size()> kPlaces{"", "PATH", "NAME", "N"};
  std::string forms;
  for (const robot::BusFacts& kind : robot::kBusFacts) {
    if (!kind.real) continue;
    forms += fmt::format("{}{}:{}", forms.empty() ? "" : " ", kind.word, kPlaces[static_cast<std::size_t>(kind.place)]);
  }
  return forms;
}

robot::Protocol protocol_of(const robot::RobotConfig& robot, std::size_t bus) {
  for (const robot::DeviceConfig& device : robot.devices) {
    const robot::Protocol protocol = robot::facts(device.kind).protocol;
    if (device.bus == bus && protocol != robot::Protocol::own) return protocol;
  }
  const bool fd = robot::is_fd(robot.buses[bus]);
  const auto* const usual = std::ranges::find_if(robot::kDeviceFacts, [fd](const robot::DeviceFacts& kind) {
    return kind.protocol != robot::Protocol::own && (fd ? kind.needs_fd : kind.needs_classic);
  });
  return usual->protocol;
}

std::string place_of(const robot::BusConfig& bus) {
  const std::string kind(robot::word(bus.kind));
  switch (robot::facts(bus.kind).place) {
    case PlaceKey::path:
      return kind + ":" + bus.path;
    case PlaceKey::interface:
      return kind + ":" + bus.interface;
    case PlaceKey::connector:
      return kind + ":" + std::to_string(bus.connector);
    case PlaceKey::none:
      break;
  }
  return kind;
}

bool same_hardware(const robot::BusConfig& a, const robot::BusConfig& b) {
  if (robot::is_serial(a) && robot::is_serial(b)) {
    std::error_code unknown;
    const auto path_a = std::filesystem::weakly_canonical(a.path, unknown);
    const auto path_b = std::filesystem::weakly_canonical(b.path, unknown);
    return path_a == path_b;
  }
  if (a.kind != b.kind) return false;
  if (robot::facts(a.kind).place == PlaceKey::interface) return a.interface == b.interface;
  return hal::type_of(a.kind).open_board != nullptr;  // used by one program as a whole
}

}  // namespace lithe::bus
