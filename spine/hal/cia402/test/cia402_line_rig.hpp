// SPDX-License-Identifier: Apache-2.0
// Two CiA 402 joints on one line, driven as the robot drives them, with a cable that a test may spoil. For tests only.
#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/bus_actuators.hpp"
#include "spine/hal/canopen/canopen_master.hpp"
#include "spine/hal/cia402/cia402_drive.hpp"
#include "spine/hal/cia402/sim/sim_cia402.hpp"
#include "spine/hal/test/cable_rig.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal {

// What spoils frames is a test's own, and no part of what must be real-time.
#if defined(__clang__) && __clang_major__ >= 20
#pragma clang diagnostic push
#pragma clang diagnostic ignored "-Wfunction-effects"
#endif

// A loop that may have no room for a frame.
class NarrowBus final : public Bus {
 public:
  void attach(BusNode& node) { loop_.attach(node); }
  void begin(std::int64_t now_ns) LITHE_RT override { loop_.begin(now_ns); }
  bool send(const Frame& frame) LITHE_RT override {
    if (!room(frame)) {
      ++statistics_.refused;
      return false;
    }
    ++statistics_.sent;
    return loop_.send(frame);
  }
  bool receive(Frame& frame) LITHE_RT override { return loop_.receive(frame); }

  std::function<bool(const Frame&)> room = [](const Frame&) { return true; };

 private:
  LoopBus loop_;
};

#if defined(__clang__) && __clang_major__ >= 20
#pragma clang diagnostic pop
#endif

struct LineParams {
  cia402::Mode mode = cia402::Mode::torque;
  JointTransform joint{-1.0, 0.3, 10.0};
  std::uint32_t device_type = 0x0002'0192;  // these two: of the first drive
  double rated_torque_nm = 0.5;
  double mgl_nm = 0;
  double heartbeat_s = 0.025;
  std::uint32_t divider = 1;
  std::uint32_t lost_after_misses = 3;
  double velocity_max_rad_s = 20;
  double torque_slew_nm_s = 1000;
  double soft_start_s = 0;
  // Quirks, of the first drive.
  bool knows_no_remote = false;
  bool refuses_while_on = false;
  std::int64_t enable_ns = 0;
  double velocity_unit = 1;
};

// Two joints; a test looks at the first and spoils what it likes.
class Cia402Line : public testing::Test {
 protected:
  static constexpr std::int64_t kMs = 1'000'000;
  static constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  static constexpr std::uint32_t kIds = 2;

  void build(const LineParams& line = {}) {
    auto bus = std::make_unique<NarrowBus>();
    bus_ = bus.get();
    for (std::uint32_t id = 1; id <= kIds; ++id) {
      sim::SimCia402Params params;
      params.id = id;
      params.device_type = id == 1 ? line.device_type : 0x0002'0192;
      params.servo.rated_torque_nm = id == 1 ? line.rated_torque_nm : 0.5;
      if (id == 1) add_quirks(line, params);
      params.servo.counts_per_rev = 65536;
      params.joint = line.joint;
      params.plant.inertia_kg_m2 = 0.05;
      params.plant.viscous_nm_s_rad = 0.01;
      params.plant.torque_lag_s = 1e-3;
      params.plant.mgl_nm = line.mgl_nm;
      params.plant.initial_position_rad = 0.2;
      cables_.push_back(std::make_unique<Cable<sim::SimCia402>>(params));
      bus->attach(*cables_.back());
    }
    actuators_.add_bus(std::move(bus), hal::canopen::sender_of,
                       std::make_unique<canopen::CanopenMaster>(
                           canopen::MasterParams{.heartbeat_s = line.heartbeat_s, .divider = line.divider}));
    for (std::uint32_t id = 1; id <= kIds; ++id) {
      const cia402::DriverParams params = driver_params(line, id);
      auto drive = std::make_unique<cia402::Cia402Drive>(params);
      drivers_.push_back(drive.get());
      actuators_.add_joint(0, id, std::move(drive), line.divider);
    }
    command_.joints = kIds;
    command_.max_torque_nm.fill(4);
    command_.position_rad.fill(kNan);
  }

  static void add_quirks(const LineParams& line, sim::SimCia402Params& params) {
    params.knows_no_remote = line.knows_no_remote;
    params.refuses_while_on = line.refuses_while_on;
    params.servo.enable_ns = line.enable_ns;
    params.servo.velocity_unit = line.velocity_unit;
  }
  static cia402::DriverParams driver_params(const LineParams& line, std::uint32_t id) {
    cia402::DriverParams params;
    params.id = id;
    params.mode = line.mode;
    params.counts_per_rev = 65536;
    params.rated_torque_nm = 0.5;
    params.torque_max_nm = 4;
    params.torque_slew_nm_s = line.torque_slew_nm_s;
    params.velocity_max_rad_s = line.velocity_max_rad_s;
    params.soft_start_s = line.soft_start_s;
    params.divider = line.divider;
    params.period_s = 0.001 * line.divider;
    params.lost_after_misses = line.lost_after_misses;
    params.joint = line.joint;
    return params;
  }

  void cycle(int times = 1) {
    for (int i = 0; i < times; ++i) {
      ++command_.tick;
      actuators_.cycle(command_, state_, now_ns_);
      now_ns_ += kMs;
    }
  }
  // The host is dead; the drives live on.
  void silence(int ms) {
    FrameQueue unheard;
    for (int i = 0; i < ms; ++i) {
      for (auto& cable : cables_) cable->on_time(now_ns_, unheard);
      unheard.clear();
      now_ns_ += kMs;
    }
  }
  void act(DriveAction action, int times = 1) {
    command_.act(action);
    cycle(times);
  }
  // From power-on to `operation enabled`.
  void enable() {
    act(DriveAction::off, 200);
    act(DriveAction::torque, 10);
  }

  bool has(std::uint32_t bit, std::size_t joint = 0) const { return (state_.status[joint] & bit) != 0; }
  bool fresh(std::size_t joint = 0) const { return has(wire::joint_status::kFresh, joint); }
  cia402::State drive_state(std::size_t joint = 0) const {
    return static_cast<cia402::State>(state_.status[joint] >> 16 & 0xff);
  }
  std::uint32_t fault_class(std::size_t joint = 0) const { return state_.status[joint] >> 8 & 0xff; }
  sim::SimCia402& drive(std::size_t joint = 0) { return cables_[joint]->drive(); }
  sim::Plant& plant(std::size_t joint = 0) { return drive(joint).servo().plant(); }

  NarrowBus* bus_ = nullptr;
  std::vector<std::unique_ptr<Cable<sim::SimCia402>>> cables_;
  std::vector<cia402::Cia402Drive*> drivers_;
  BusActuators actuators_;
  ActuatorCommand command_;
  ActuatorState state_;
  std::int64_t now_ns_ = 1'000 * kMs;
};

}  // namespace lithe::hal
