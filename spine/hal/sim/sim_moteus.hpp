// SPDX-License-Identifier: Apache-2.0
// A simulated moteus at the far end of a bus: takes real frames, answers real frames.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/bus/frame.hpp"
#include "spine/hal/bus/loop_bus.hpp"
#include "spine/hal/device/moteus_codec.hpp"
#include "spine/hal/sim/servo.hpp"

namespace lithe::hal::sim {

struct SimMoteusParams {
  std::uint32_t id = 1;  // 1 to 126
  ServoParams servo;
  JointTransform joint;
  PlantParams plant;
};

// As the firmware does: subframes in order; the answer tells the state before the command; writing the mode resets
// every command register, and without it the written registers are kept but nothing is commanded; a read that fails
// ends the frame, a write that fails does not; bytes that make no sense end the frame, and the answer goes out all the
// same. Simulated are the modes 0 to 4 and 9 to 13 and 15; the others are refused like an unknown value.
// Contract: RT · one thread · lives on the time of the frames it sees
class SimMoteus final : public BusNode {
 public:
  explicit SimMoteus(const SimMoteusParams& params)
      : id_(params.id), servo_(params.servo, params.joint, params.plant) {}

  void on_frame(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT override;

  Servo& servo() LITHE_RT { return servo_; }

 private:
  enum class Access : std::uint32_t { done = 0, unknown = 1, read_only = 2 };  // the protocol's own error numbers

  void serve(const Frame& request, Frame& answer) LITHE_RT;
  void write(const moteus::Subframe& subframe, moteus::SubframeWriter& answer) LITHE_RT;
  bool read(const moteus::Subframe& subframe, moteus::SubframeWriter& answer) LITHE_RT;
  Access write_register(std::uint32_t number, double value) LITHE_RT;
  Access write_mode(double value) LITHE_RT;
  bool read_register(std::uint32_t number, double& value) LITHE_RT;
  bool read_status(std::uint32_t number, double& value) LITHE_RT;

  std::uint32_t id_;
  Servo servo_;
  ServoCommand command_;  // as the registers stand now
  bool commanded_ = false;
  moteus::Mode commanded_mode_ = moteus::Mode::stopped;
};

}  // namespace lithe::hal::sim
