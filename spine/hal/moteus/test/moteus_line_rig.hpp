// SPDX-License-Identifier: Apache-2.0
// For tests: a moteus driver and a simulated drive, with a function between them that can change frames.
#pragma once

#include <limits>
#include <memory>
#include <string>
#include <utility>

#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/bus_actuators.hpp"
#include "spine/hal/moteus/moteus.hpp"
#include "spine/hal/moteus/sim/sim_moteus.hpp"
#include "spine/hal/test/cable_rig.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal {

struct MoteusLine {
  static constexpr std::int64_t kMs = 1'000'000;

  explicit MoteusLine(const moteus::DriverParams& driver, const sim::SimMoteusParams& params = {}) : node(params) {
    auto own = std::make_unique<LoopBus>();
    bus = own.get();
    own->attach(node);
    actuators.add_bus(std::move(own), hal::moteus::device_of);
    auto drive = std::make_unique<moteus::MoteusDrive>(driver);
    moteus = drive.get();
    actuators.add_joint(0, driver.id, std::move(drive));
    command.joints = 1;
    command.max_torque_nm[0] = 1;
    command.position_rad[0] = std::numeric_limits<double>::quiet_NaN();
  }

  static moteus::DriverParams asking() {
    moteus::DriverParams params{.id = 1, .joint = {}};
    params.ask_settings = true;
    return params;
  }

  void cycle(int times = 1) {
    for (int i = 0; i < times; ++i) {
      now_ns += kMs;
      actuators.cycle(command, state, now_ns);
    }
  }
  void act(DriveAction action, int times) {
    command.act(action);
    cycle(times);
  }
  bool has(std::uint32_t bit) const { return (state.status[0] & bit) != 0; }
  bool ready() const { return has(wire::joint_status::kFresh) && !has(wire::joint_status::kNotReady); }
  std::uint32_t mode() const { return state.status[0] >> 16 & 0xff; }
  // Sends one line to the drive's console, as another client.
  void tell(const std::string& line) {
    Frame frame;
    frame.id = 1;
    moteus::SubframeWriter writer(frame);
    const std::string text = line + "\n";
    writer.client_data(1, {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()});
    FrameQueue none;
    node.drive().on_frame(frame, now_ns, none);
  }

  Cable<sim::SimMoteus> node;
  LoopBus* bus;
  BusActuators actuators;
  moteus::MoteusDrive* moteus;
  ActuatorCommand command;
  ActuatorState state;
  std::int64_t now_ns = 1'000 * kMs;
};

}  // namespace lithe::hal
