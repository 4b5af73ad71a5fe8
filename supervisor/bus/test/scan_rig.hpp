// SPDX-License-Identifier: Apache-2.0
// For tests: simulated devices at the far end of a bus, which are scanned, and robots that expect them.
#pragma once

#include <algorithm>
#include <array>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/cia402/sim/sim_cia402.hpp"
#include "spine/hal/gateway/sim/sim_gateway.hpp"
#include "spine/hal/moteus/sim/sim_moteus.hpp"
#include "supervisor/bus/scan/scan.hpp"

namespace lithe::bus::test {

using hal::Frame;
using robot::DeviceKind;

// Passes everything on and remembers every frame that was sent.
class Watched : public hal::Bus {
 public:
  void begin(std::int64_t now_ns) LITHE_RT override {
    // A LoopBus drops old frames at begin(); a real wire does not.
    Frame frame;
    while (inner_.receive(frame)) kept_.push(frame);
    inner_.begin(now_ns);
  }
  bool send(const Frame& frame) LITHE_RT override {
    sent_[count_++ % sent_.size()] = frame;
    return inner_.send(frame);
  }
  bool receive(Frame& frame) LITHE_RT override {
    if (const Frame* next = kept_.front()) {
      frame = *next;
      kept_.pop();
      return true;
    }
    return inner_.receive(frame);
  }
  void attach(hal::BusNode& node) { inner_.attach(node); }
  std::uint32_t bitrate() const { return 1'000'000; }
  std::vector<Frame> sent() const { return {sent_.begin(), sent_.begin() + static_cast<std::ptrdiff_t>(count_)}; }

 private:
  hal::LoopBus inner_;
  hal::FrameQueue kept_;
  std::array<Frame, 1024> sent_{};
  std::size_t count_ = 0;
};

// Wire: a Watched.
template <class Wire>
class ScanRigOn {
 public:
  void add_moteus(std::uint32_t id, std::uint64_t serial) {
    hal::sim::SimMoteusParams params;
    params.id = id;
    params.serial = serial;
    add(std::make_unique<hal::sim::SimMoteus>(params));
  }
  void add_drive(std::uint32_t id) {
    hal::sim::SimCia402Params params;
    params.id = id;
    add(std::make_unique<hal::sim::SimCia402>(params));
  }
  void add_gateway(std::uint32_t id) { add(std::make_unique<hal::sim::SimGateway>(id, 1'000'000, true)); }
  void add(std::unique_ptr<hal::BusNode> node) {
    bus_.attach(*node);
    nodes_.push_back(std::move(node));
  }

  Time time() {
    return {[this] { return now_ns_; },
            [this] {
              now_ns_ += 1'000'000;
              bus_.begin(now_ns_);  // devices send by themselves
            }};
  }
  Line scan(robot::Protocol protocol) {
    std::vector<Line> lines;
    lines.emplace_back(&bus_, protocol, bus_.bitrate());
    listen(lines, 20'000'000, time());
    ask(lines.front(), time());
    return std::move(lines.front());
  }
  Wire& bus() { return bus_; }
  std::int64_t now_ns() const { return now_ns_; }

 private:
  std::vector<std::unique_ptr<hal::BusNode>> nodes_;
  Wire bus_;
  std::int64_t now_ns_ = 1'000'000'000;
};
using ScanRig = ScanRigOn<Watched>;

inline robot::RobotConfig robot_with(std::vector<std::pair<DeviceKind, std::uint32_t>> devices) {
  robot::RobotConfig robot;
  robot.path = "robot.toml";
  robot.buses.emplace_back();
  for (const auto& [kind, id] : devices) {
    robot::DeviceConfig device;
    device.name = "device" + std::to_string(id);
    device.kind = kind;
    device.id = id;
    robot.devices.push_back(device);
  }
  return robot;
}

// All that was found, of any kind.
inline std::vector<hal::FoundDevice> found(const Line& line) {
  std::vector<hal::FoundDevice> all;
  for (const Line::KindScanner& each : line.scanners)
    for (hal::FoundDevice& one : each.scanner->found(true)) all.push_back(std::move(one));
  return all;
}

inline const Judged& of(const BusFindings& findings, std::uint32_t id) {
  return *std::find_if(findings.devices.begin(), findings.devices.end(), [id](const Judged& e) { return e.id == id; });
}

}  // namespace lithe::bus::test
