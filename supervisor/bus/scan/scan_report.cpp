// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/scan/scan_report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <memory>

#include "spine/hal/open_bus.hpp"
#include "supervisor/bus/scan/scan.hpp"

namespace lithe::bus {
namespace {

constexpr const char* kSimulated =
    "simulated: its devices live in the Spine; `lithe sim` puts them where others reach them";

bool found_something(const BusFindings& findings) { return !findings.devices.empty(); }

std::unique_ptr<hal::Bus> open_line(hal::BusOpener& opener, const robot::BusConfig& config, BusFindings& findings) {
  Result<std::unique_ptr<hal::Bus>> bus = opener.open(config);
  if (bus) return std::move(*bus);
  findings.error = bus.message();
  return nullptr;
}

Json or_null(const std::string& text) { return text.empty() ? Json(nullptr) : Json(text); }

// Errors are shown beside other findings, not alone: many adapters refuse a frame occasionally.
void note_errors(const hal::BusStatistics& n, BusFindings& findings) {
  if (n.refused + n.errors == 0 || matches(findings)) return;
  findings.note = fmt::format(
      "the adapter reports {} errors and has refused {} frames: check wires, termination and bit rates; two devices "
      "with one id do this, too",
      n.errors, n.refused);
}

}  // namespace

Scan scan(const Choice& choice, const ScanOptions& options) {
  hal::BusOpener opener(choice.robot.buses, true);
  std::vector<std::unique_ptr<hal::Bus>> open;
  std::vector<Line> lines;
  Scan done;
  for (const std::size_t index : choice.buses) {
    const robot::BusConfig& config = choice.robot.buses[index];
    done.buses.push_back({index, {}, "", ""});
    open.push_back(robot::is_real(config) ? open_line(opener, config, done.buses.back()) : nullptr);
    if (!robot::is_real(config)) done.buses.back().note = kSimulated;
    lines.emplace_back(open.back().get(), protocol_of(choice.robot, index), config.bitrate);
  }
  const Time time = real_time();
  if (std::any_of(open.begin(), open.end(), [](const auto& bus) { return bus != nullptr; }))
    listen(lines, std::llround(1e9 * options.listen_s), time);
  for (std::size_t i = 0; i < lines.size(); ++i) {
    if (open[i] == nullptr) continue;
    ask(lines[i], time);
    done.buses[i] = judge(choice.robot, choice.buses[i], choice.from_file, lines[i]);
    note_errors(open[i]->statistics(), done.buses[i]);
  }
  done.matches = std::all_of(done.buses.begin(), done.buses.end(), matches) &&
                 (choice.from_file || std::any_of(done.buses.begin(), done.buses.end(), found_something));
  return done;
}

Json to_json(const Scan& scan, const Choice& choice) {
  Json buses = Json::array();
  for (const BusFindings& each : scan.buses) {
    const robot::BusConfig& config = choice.robot.buses[each.bus];
    Json devices = Json::array();
    for (const Judged& device : each.devices) {
      devices.push_back({{"kind", robot::word(device.kind)},
                         {"id", device.id},
                         {"name", or_null(device.name)},
                         {"standing", word(device.standing)},
                         {"says", device.what},
                         {"advice", or_null(device.advice)}});
    }
    buses.push_back({{"name", config.name},
                     {"place", place_of(config)},
                     {"trouble", or_null(each.error)},
                     {"note", or_null(each.note)},
                     {"matches", matches(each)},
                     {"devices", devices}});
  }
  return {{"robot", choice.from_file ? Json(choice.robot.name) : Json(nullptr)},
          {"matches", scan.matches},
          {"buses", buses}};
}

std::string to_text(const Scan& scan, const Choice& choice) {
  std::string text;
  std::string next;
  for (const BusFindings& each : scan.buses) {
    const robot::BusConfig& config = choice.robot.buses[each.bus];
    const std::string place = place_of(config);
    text += config.name == place ? place + "\n" : fmt::format("{} ({})\n", config.name, place);
    for (const Judged& device : each.devices) {
      text += fmt::format("  {:<8} id {:<4} {:<9} {:<20} {}\n", robot::word(device.kind), device.id,
                          word(device.standing), device.name, device.what);
      if (!device.advice.empty()) next += fmt::format("  {} id {}: {}\n", config.name, device.id, device.advice);
    }
    for (const std::string& words : {each.error, each.note})
      if (!words.empty()) text += "  " + words + "\n";
    if (each.devices.empty() && each.error.empty() && each.note.empty()) text += "  nothing answers\n";
  }
  if (scan.matches) return text + (choice.from_file ? "all is as " + choice.robot.path + " says\n" : "");
  text += choice.from_file ? "NOT as " + choice.robot.path + " says\n" : "";
  return text + (next.empty() ? "" : "next:\n" + next);
}

}  // namespace lithe::bus
