// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/monitor/monitor.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <string_view>
#include <thread>

#include "spine/core/lookup.hpp"
#include "spine/core/time.hpp"
#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/canopen/canopen_pdo.hpp"
#include "spine/hal/open_bus.hpp"
#include "spine/hal/registry.hpp"
#include "supervisor/bus/plan/frame_time.hpp"

namespace lithe::bus {
namespace {

std::string hex(const hal::Frame& frame) {
  std::string text;
  for (const std::uint8_t byte : frame.payload()) text += fmt::format("{:02x}", byte);
  return text;
}

const char* format_of(const hal::Frame& frame) { return !frame.fd ? "classic" : frame.brs ? "FD BRS" : "FD"; }

hal::BitRates rates_of(const robot::BusConfig& bus) { return {bus.bitrate, std::max(bus.bitrate, bus.data_bitrate)}; }

}  // namespace

Result<std::unique_ptr<BusListener>> BusListener::open(const Choice& choice, const std::vector<std::size_t>& buses) {
  auto listener = std::make_unique<BusListener>();
  hal::BusOpener opener(choice.robot.buses, true);
  for (const std::size_t number : buses) {
    Result<std::unique_ptr<hal::Bus>> bus = opener.open(choice.robot.buses[number]);
    if (!bus) return bus.error();
    (*bus)->begin(monotonic_ns());
    listener->buses_.push_back({number, std::move(*bus)});
  }
  return listener;
}

bool BusListener::next(CapturedFrame& captured) {
  for (std::size_t i = 0; i < buses_.size(); ++i) {
    const ListenedBus& each = buses_[turn_++ % buses_.size()];
    if (!each.bus->receive(captured.frame)) continue;
    captured.time_ns = monotonic_ns();
    captured.bus = each.number;
    captured.outbound.reset();
    return true;
  }
  return false;
}

std::string BusListener::why_down() {
  std::string all;
  for (const ListenedBus& each : buses_) {
    const std::string why = each.bus->why_down();  // read before begin(), which may reopen the bus
    if (!why.empty()) all += (all.empty() ? "" : "; ") + why;
    each.bus->service();
    each.bus->begin(monotonic_ns());  // uses the reopened bus
  }
  return all;
}

std::uint64_t BusListener::lost() const {
  std::uint64_t all = 0;
  for (const ListenedBus& each : buses_) all += each.bus->overrun();
  return all;
}

std::uint64_t BusListener::errors(std::size_t bus) const {
  for (const ListenedBus& each : buses_)
    if (each.number == bus) return each.bus->statistics().errors + each.bus->statistics().malformed;
  return 0;
}

Monitor::Monitor(const Choice& choice, const MonitorOptions& options, std::int64_t start_ns)
    : choice_(choice), options_(options), start_ns_(start_ns), tallies_(choice.robot.buses.size()) {
  for (std::size_t i = 0; i < choice.robot.buses.size(); ++i) protocols_.push_back(protocol_of(choice.robot, i));
}

std::string Monitor::complaint() const {
  const std::string names = joined(choice_.robot.devices, &robot::DeviceConfig::name);
  for (const std::string& wanted : options_.devices) {
    const bool is_id = !wanted.empty() && wanted.find_first_not_of("0123456789") == std::string::npos;
    const auto is_it = [&](const robot::DeviceConfig& device) { return device.name == wanted; };
    if (is_id || std::ranges::any_of(choice_.robot.devices, is_it)) continue;
    return fmt::format("there is no device '{}'; {}", wanted, names.empty() ? "give its id" : "there are " + names);
  }
  return "";
}

std::string Monitor::name_of(std::size_t bus, std::optional<std::uint32_t> device) const {
  if (!device) return "";
  for (const robot::DeviceConfig& each : choice_.robot.devices)
    if (each.bus == bus && each.id == *device) return each.name;
  return "";
}

bool Monitor::shows(const std::string& name, std::optional<std::uint32_t> device) const {
  if (options_.devices.empty()) return true;
  return std::ranges::any_of(options_.devices, [&](const std::string& wanted) {
    return (!name.empty() && wanted == name) || (device && wanted == std::to_string(*device));
  });
}

std::optional<std::string> Monitor::see(const CapturedFrame& captured) {
  if (captured.bus >= tallies_.size()) return std::nullopt;
  const hal::Frame& frame = captured.frame;
  const robot::BusConfig& bus = choice_.robot.buses[captured.bus];
  const hal::FrameText decoded = decode(frame, protocols_[captured.bus], choice_.robot, captured.bus);
  const bool outbound = captured.outbound.value_or(decoded.outbound);
  Tally& tally = tallies_[captured.bus];
  ++(outbound ? tally.out : tally.in);
  tally.busy_ns += hal::duration_ns(hal::exact_bits(frame), rates_of(bus));
  const std::string name = name_of(captured.bus, decoded.device);
  if (!shows(name, decoded.device)) return std::nullopt;
  ++shown_;
  const double time_s = 1e-9 * static_cast<double>(captured.time_ns - start_ns_);
  if (options_.json) {
    Json line = {{"time_s", time_s},
                 {"bus", bus.name},
                 {"direction", outbound ? "out" : "in"},
                 {"id", frame.id},
                 {"device_id", decoded.device ? Json(*decoded.device) : Json(nullptr)},
                 {"device", name.empty() ? Json(nullptr) : Json(name)},
                 {"format", format_of(frame)},
                 {"says", decoded.text}};
    if (options_.raw) line["data"] = hex(frame);
    return line.dump(-1, ' ', false, Json::error_handler_t::replace);
  }
  const std::string who = !name.empty() ? name : decoded.device ? fmt::format("id {}", *decoded.device) : "all";
  std::string line = fmt::format("{:11.6f} {:<8} {} {:<8x} {:<18} {}", time_s, bus.name, outbound ? ">" : "<", frame.id,
                                 who, decoded.text);
  if (options_.raw) line += fmt::format("  [{} {}] {}", format_of(frame), frame.payload().size(), hex(frame));
  return line;
}

bool Monitor::finished(std::int64_t now_ns) const {
  if (options_.count > 0 && shown_ >= options_.count) return true;
  return options_.seconds > 0 && now_ns - start_ns_ >= std::llround(1e9 * options_.seconds);
}

Json Monitor::statistics(const FrameSource& source, std::int64_t now_ns) const {
  const double seconds = std::max(1e-9 * static_cast<double>(now_ns - start_ns_), 1e-9);
  Json buses = Json::array();
  for (const std::size_t number : choice_.buses) {
    const Tally& tally = tallies_[number];
    buses.push_back({{"name", choice_.robot.buses[number].name},
                     {"out", tally.out},
                     {"in", tally.in},
                     {"frames_per_s", static_cast<double>(tally.out + tally.in) / seconds},
                     {"load", 1e-9 * static_cast<double>(tally.busy_ns) / seconds},
                     {"errors", source.errors(number)}});
  }
  return {{"statistics", {{"seconds", seconds}, {"not_seen", source.lost()}, {"buses", buses}}}};
}

std::string statistics_text(const Json& document) {
  const Json& all = document.at("statistics");
  std::string text = fmt::format("\n{:<12} {:>9} {:>9} {:>10} {:>7} {:>8}   in {:.2f} s", "bus", "out", "in",
                                 "frames/s", "load", "errors", all.at("seconds").get<double>());
  for (const Json& bus : all.at("buses")) {
    text += fmt::format("\n{:<12} {:>9} {:>9} {:>10.1f} {:>5.1f} % {:>8}", bus.at("name").get<std::string>(),
                        bus.at("out").get<std::uint64_t>(), bus.at("in").get<std::uint64_t>(),
                        bus.at("frames_per_s").get<double>(), 100 * bus.at("load").get<double>(),
                        bus.at("errors").get<std::uint64_t>());
  }
  const auto lost = all.at("not_seen").get<std::uint64_t>();
  return lost == 0 ? text : text + fmt::format("\n{} frames passed too fast to be shown", lost);
}

int watch(FrameSource& source, Monitor& monitor, const MonitorOptions& options, const std::function<bool()>& stop,
          const std::function<void(const std::string&)>& say, const std::function<void(const std::string&)>& warn) {
  constexpr auto kPause = std::chrono::microseconds(500);
  bool any = false;
  std::int64_t look_at_ns = 0;
  std::string error;
  while (!stop() && !monitor.finished(monotonic_ns())) {
    if (monotonic_ns() >= look_at_ns) {
      look_at_ns = monotonic_ns() + kNsPerS;
      const std::string now = source.why_down();
      if (now != error) warn(now.empty() ? "all is heard again" : now);
      error = now;
    }
    CapturedFrame captured;
    if (!source.next(captured)) {
      std::this_thread::sleep_for(kPause);
      continue;
    }
    any = true;
    if (const auto line = monitor.see(captured)) say(*line);
  }
  const Json statistics = monitor.statistics(source, monotonic_ns());
  say(options.json ? statistics.dump() : statistics_text(statistics));
  return any ? 0 : 1;
}

namespace {

namespace canopen = hal::canopen;

std::string_view object_name(std::uint16_t index) {
  for (const hal::DeviceType& type : hal::device_types()) {
    const std::string_view name = type.object_name != nullptr ? type.object_name(index) : std::string_view();
    if (!name.empty()) return name;
  }
  return {};
}

std::string process_text(const hal::DeviceType& type, const canopen::PdoMap& map, const hal::Frame& frame) {
  std::array<std::uint32_t, canopen::PdoMap::kMost> values{};
  if (!map.unpack(frame, values)) return "shorter than it is mapped: " + hal::bytes_text(frame);
  std::string text;
  for (std::size_t i = 0; i < map.objects().size(); ++i)
    text += (text.empty() ? "" : ", ") + type.process_value(map.objects()[i], values[i]);
  return text;
}

std::string process_data(const hal::Frame& frame, const robot::RobotConfig& robot, std::size_t bus) {
  for (const robot::DeviceConfig& device : robot.devices) {
    const hal::DeviceType& type = hal::type_of(device.kind);
    if (device.bus != bus || device.id != canopen::node_of(frame) || type.process_map == nullptr) continue;
    canopen::PdoMap map;
    if (type.process_map(device, frame.id, map)) return process_text(type, map, frame);
  }
  return "";
}

}  // namespace

hal::FrameText decode(const hal::Frame& frame, robot::Protocol protocol, const robot::RobotConfig& robot,
                      std::size_t bus) {
  const hal::FrameContext context{[&](const hal::Frame& pdo) { return process_data(pdo, robot, bus); }, object_name};
  const hal::DeviceType* speaks = nullptr;
  for (const hal::DeviceType& type : hal::device_types()) {
    if (type.is_own != nullptr && type.is_own(frame)) return type.frame_text(frame, context);
    if (type.frame_text != nullptr && robot::facts(type.kind).protocol == protocol) speaks = &type;
  }
  return speaks != nullptr ? speaks->frame_text(frame, context) : hal::FrameText{false, {}, hal::bytes_text(frame)};
}

}  // namespace lithe::bus
