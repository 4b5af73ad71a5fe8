// SPDX-License-Identifier: Apache-2.0
// A simulated moteus: real frames in, real frames out, with the device's own semantics, on a simulated joint.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/bus/loop_bus.hpp"
#include "spine/hal/device/moteus.hpp"
#include "spine/hal/device/moteus_codec.hpp"
#include "spine/hal/sim/plant.hpp"

namespace lithe::hal {

// Configuration of the servo that the protocol does not carry (firmware 1.0 defaults, as commissioned for an arm).
struct SimServo {
  double kp_nm_rev = 4.0;
  double kd_nm_s_rev = 0.05;
  double default_timeout_s = 0.1;
  double default_accel_limit_rev_s2 = 50.0;
  double position_min_rev = -100.0;
  double position_max_rev = 100.0;
  double timeout_max_torque_nm = 5.0;
  double max_torque_nm = 2.0;
  double enable_s = 0.005;  // current-offset calibration between stopped and the first mode
  double supply_v = 24.0;
};

// Semantics copied from the firmware: writing the mode resets every command field and must come first; fields without a
// mode are stored, never applied; the reply shows the state before the command; fault and timeout leave only through
// mode 0; the watchdog runs in position mode alone and latches mode 11 (damping).
// Contract: RT · deterministic, time is an argument · one thread
class SimMoteus final : public FarEnd {
 public:
  SimMoteus(const MoteusSettings& settings, const robot::PlantConfig& plant, const SimServo& servo = {});

  bool serve(const Frame& frame, Frame& reply, std::int64_t now_ns) LITHE_RT override;

  // Lives on until `now_ns`. A gap longer than 200 ms is a jump: the device catches up that much and no more.
  void advance(std::int64_t now_ns) LITHE_RT;

  // What a person could do to it: a fault of the drive, by code (moteus::fault_name).
  void inject_fault(std::uint8_t code) LITHE_RT;

  std::uint8_t mode() const LITHE_RT { return mode_; }
  std::uint8_t fault() const LITHE_RT { return fault_; }
  const Plant& plant() const LITHE_RT { return plant_; }

 private:
  // Command registers 0x020..0x02b as the last mode write left them.
  struct Fields {
    double position, velocity, torque, kp_scale, kd_scale, max_torque, stop, timeout_s, velocity_limit, accel_limit;
  };
  static Fields defaults() LITHE_RT;

  void write_register(std::uint32_t address, double value, bool& wrote_mode, moteus::Writer& writer) LITHE_RT;
  bool read_register(std::uint32_t address, double& value) const LITHE_RT;
  void answer_read(const moteus::Subframe& subframe, moteus::Writer& writer) LITHE_RT;
  void apply_command() LITHE_RT;
  void start_position_mode() LITHE_RT;
  void step() LITHE_RT;
  double motor_torque_nm() LITHE_RT;
  void follow_target() LITHE_RT;
  void sense() LITHE_RT;

  MoteusSettings settings_;
  SimServo servo_;
  Plant plant_;
  double counts_per_rev_;
  std::uint8_t mode_ = moteus::kStopped;
  std::uint8_t wanted_mode_ = moteus::kStopped;
  std::uint8_t fault_ = 0;
  Fields written_ = defaults();  // what frames have written so far
  Fields active_ = defaults();   // what the last mode write has put into force
  std::uint8_t written_mode_ = moteus::kStopped;
  double control_position_rev_ = 0;  // the servo's own target, which follows the commanded one
  double control_velocity_rev_s_ = 0;
  double enabling_left_s_ = 0;
  double watchdog_left_s_ = 0;
  std::int64_t lived_until_ns_ = 0;
  double position_rev_ = 0;  // as the encoder sees it
  double velocity_rev_s_ = 0;
  double tracked_rev_ = 0;
};

}  // namespace lithe::hal
