// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/scan/scan.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>
#include <thread>
#include <utility>

#include "spine/core/time.hpp"
#include "spine/hal/open_bus.hpp"
#include "spine/hal/registry.hpp"

namespace lithe::bus {

namespace {

constexpr std::int64_t kSilenceNs = 1'500'000'000;

}  // namespace

Time real_time() {
  return {[] { return monotonic_ns(); }, [] { std::this_thread::sleep_for(std::chrono::microseconds(200)); }};
}

// One scanner for the protocol, and one for each kind that is recognised on every bus.
Line::Line(hal::Bus* opened, robot::Protocol protocol, std::uint32_t bitrate_hz) : bus(opened), bitrate(bitrate_hz) {
  bool asks = false;
  for (const hal::DeviceType& type : hal::device_types()) {
    const bool speaks = protocol != robot::Protocol::own && robot::facts(type.kind).protocol == protocol;
    if (type.make_scanner == nullptr || !(type.is_own != nullptr || (speaks && !asks))) continue;
    asks = asks || speaks;
    scanners.push_back({type.kind, type.make_scanner()});
  }
}

void Line::on_frame(const hal::Frame& frame) {
  const auto own = std::ranges::find_if(scanners, [&frame](const KindScanner& each) {
    const auto is_own = hal::type_of(each.kind).is_own;
    return is_own != nullptr && is_own(frame);
  });
  if (own != scanners.end()) {
    own->scanner->on_frame(frame);
    return;
  }
  for (const KindScanner& each : scanners) {
    if (hal::type_of(each.kind).is_own != nullptr) continue;
    std::string evidence = each.scanner->on_frame(frame);
    if (commander.empty()) commander = std::move(evidence);
  }
}

void listen(std::vector<Line>& lines, std::int64_t for_ns, const Time& time) {
  const std::int64_t end_ns = time.now_ns() + for_ns;
  for (Line& line : lines)
    if (line.bus != nullptr) line.bus->begin(time.now_ns());
  while (time.now_ns() < end_ns) {
    bool received = false;
    for (Line& line : lines) {
      hal::Frame frame;
      if (line.bus == nullptr || !line.bus->receive(frame)) continue;
      line.on_frame(frame);
      received = true;
    }
    if (!received) time.pause();
  }
}

void ask(Line& line, const Time& time) {
  if (line.bus == nullptr) return;
  const hal::AskedBus asked{*line.bus, time, line.bitrate, [&line](const hal::Frame& frame) { line.on_frame(frame); }};
  if (line.commander.empty())
    for (const Line::KindScanner& each : line.scanners) line.error += each.scanner->ask(asked);
  // Some adapters notice only here that nothing is sent; others tell a bus-off only when asked, after a silence.
  const auto nothing = [](const auto& each) { return each.scanner->found(true).empty(); };
  const bool silent = line.commander.empty() && std::ranges::all_of(line.scanners, nothing);
  const std::int64_t end_ns = time.now_ns() + (silent ? kSilenceNs : 0);
  do {
    line.bus->begin(time.now_ns());
    line.bus->flush();
    hal::Frame frame;
    if (line.bus->receive(frame))
      line.on_frame(frame);
    else if (silent)
      time.pause();
  } while (time.now_ns() < end_ns && line.bus->why_down().empty());
  if (std::string down = line.bus->why_down(); !down.empty()) line.error = std::move(down);
}

void look(const robot::RobotConfig& robot, BusFindings& findings, Line& line, const Time& time) {
  if (line.bus == nullptr || !findings.error.empty()) return;
  const hal::AskedBus asked{*line.bus, time, line.bitrate, [&line](const hal::Frame& frame) { line.on_frame(frame); }};
  for (Judged& device : findings.devices) {
    const auto in_file = std::ranges::find(robot.devices, device.name, &robot::DeviceConfig::name);
    const auto look_at = hal::type_of(device.kind).look;
    if (device.standing != Standing::expected || look_at == nullptr || in_file == robot.devices.end()) continue;
    device.advice = look_at(robot, *in_file, asked);
    if (!device.advice.empty()) device.standing = Standing::unfit;
  }
}

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
  if (std::ranges::any_of(open, [](const auto& bus) { return bus != nullptr; }))
    listen(lines, std::llround(1e9 * options.listen_s), time);
  for (std::size_t i = 0; i < lines.size(); ++i) {
    if (open[i] == nullptr) continue;
    ask(lines[i], time);
    done.buses[i] = judge(choice.robot, choice.buses[i], choice.from_file, lines[i]);
    look(choice.robot, done.buses[i], lines[i], time);
    note_errors(open[i]->statistics(), done.buses[i]);
  }
  done.matches = std::ranges::all_of(done.buses, matches) &&
                 (choice.from_file || std::ranges::any_of(done.buses, found_something));
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
  if (scan.matches && choice.from_file) {
    const auto is_real = [&](std::size_t index) { return robot::is_real(choice.robot.buses[index]); };
    if (std::ranges::none_of(choice.buses, is_real))
      return text + "nothing was asked: there is no real bus among these\n";
    const bool all = std::ranges::all_of(choice.buses, is_real);
    return text + (all ? "all that a scan can read is as " : "all that was asked is as ") + choice.robot.path +
           " says\n";
  }
  if (scan.matches) return text;
  text += choice.from_file ? "NOT as " + choice.robot.path + " says\n" : "";
  return text + (next.empty() ? "" : "next:\n" + next);
}

}  // namespace lithe::bus
