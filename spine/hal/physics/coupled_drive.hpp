// SPDX-License-Identifier: Apache-2.0
// What simulated drives share (their time grid, their plant, the encoder on it), and what a simulated device is made
// from.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

#include "spine/core/rt.hpp"
#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/core/drive.hpp"
#include "spine/hal/physics/plant.hpp"
#include "spine/hal/physics/truth.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal::sim {

// A simulated drive whose plant can be moved by a mechanism (Coupling). Its encoder gives whole counts; a tracking loop
// (two poles) computes the velocity.
// Contract: RT · one thread · time is an argument · same commands at the same times, same motion
class CoupledDrive {
 public:
  // Longest time that one advance() simulates; the rest is skipped for the plant.
  static constexpr std::int64_t kMaxCatchUpNs = 50'000'000;

  virtual ~CoupledDrive() = default;

  // Simulates up to `now_ns` on a 50 us grid that starts with the first call. Time that goes backwards is ignored.
  void advance(std::int64_t now_ns) LITHE_RT;
  // Skips time without simulating it; watchdogs run.
  // Contract: after the first advance()
  void skip(std::int64_t now_ns) LITHE_RT;
  // Puts the joint back to its start, at rest; the drive continues and sees no motion.
  void to_start() LITHE_RT;
  Plant& plant() LITHE_RT { return plant_; }

 protected:
  struct Encoder {
    double counts_per_rev = 4096;
    double filter_hz = 200;  // bandwidth of the tracking loop
  };

  CoupledDrive(const Encoder& encoder, const JointTransform& joint, const PlantParams& plant,
               const DriveErrors& errors);

  virtual void step() LITHE_RT = 0;
  virtual void on_skip() LITHE_RT {}

  // One step of the plant and the encoder with this torque of the motor (finite).
  void move(double motor_nm) LITHE_RT;
  // Reads the encoder.
  void measure() LITHE_RT;
  void set_encoder(const Encoder& encoder) LITHE_RT { encoder_ = encoder; }

  JointTransform joint_;
  Plant plant_;
  ErrorSource errors_;
  bool started_ = false;
  std::int64_t time_ns_ = 0;
  double offset_rev_ = 0;  // read position minus the motor's position
  double encoder_rev_ = 0;
  double tracked_rev_ = 0;
  double velocity_rev_s_ = 0;

 private:
  Encoder encoder_;
};

// A simulated device at the far end of a bus.
struct SimDevice {
  std::unique_ptr<BusNode> node;
  CoupledDrive* drive = nullptr;  // of the node; null: it moves nothing
};

// One device of a robot, and what its motor moves. A device that measures has no use for the lower four.
struct SimPlace {
  const robot::DeviceConfig& device;
  const robot::BusConfig& bus;
  std::size_t index = 0;  // of the device in its robot
  std::uint32_t encoder_counts = 0;
  JointTransform joint{};
  PlantParams plant{};
  DriveErrors errors{};
};

}  // namespace lithe::hal::sim
