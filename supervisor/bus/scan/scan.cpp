// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/scan/scan.hpp"

#include <algorithm>
#include <chrono>
#include <thread>
#include <utility>

#include "spine/core/time.hpp"
#include "spine/hal/registry.hpp"

namespace lithe::bus {

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
  const auto own = std::find_if(scanners.begin(), scanners.end(), [&frame](const KindScanner& each) {
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
  line.bus->begin(time.now_ns());  // some adapters notice only here that nothing is sent
  if (std::string down = line.bus->why_down(); !down.empty()) line.error = std::move(down);
}

}  // namespace lithe::bus
