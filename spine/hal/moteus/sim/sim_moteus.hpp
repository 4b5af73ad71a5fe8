// SPDX-License-Identifier: Apache-2.0
// A simulated moteus at the far end of a bus: same frames as a real drive.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <optional>

#include "spine/core/rt.hpp"
#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/core/frame.hpp"
#include "spine/hal/moteus/moteus_codec.hpp"
#include "spine/hal/moteus/sim/moteus_config.hpp"
#include "spine/hal/moteus/sim/moteus_console.hpp"
#include "spine/hal/moteus/sim/servo.hpp"
#include "spine/hal/physics/coupled_drive.hpp"

namespace lithe::hal::sim {

struct SimMoteusParams {
  std::uint32_t id = 1;      // 1 to 126
  std::uint64_t serial = 0;  // serial number and UUID are derived from it
  ServoParams servo;
  JointTransform joint;
  PlantParams plant;
  DriveErrors errors{};
};

// As the firmware does: subframes in order; the answer has the state before the command; writing the mode resets every
// command register, and without it the written registers are kept but nothing is commanded; a read that fails ends the
// frame, a write that fails does not; invalid bytes end the frame, but the answer is still sent; a frame with another
// drive's UUID mask is ignored. Channel 1 is the console. Flow control of streams (0x43, 0x44) is ignored, as by
// firmware without it. Simulated are the modes 0 to 4, 9 to 13 and 15; the others are refused like an unknown value.
// Contract: RT · one thread · time comes from the frames received
class SimMoteus final : public BusNode {
 public:
  explicit SimMoteus(const SimMoteusParams& params)
      : inside_(params.servo, params.joint, params.plant, params.errors, params.id, params.serial) {}

  void on_frame(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT override;
  void on_time(std::int64_t now_ns, FrameQueue& /*answers*/) LITHE_RT override { inside_.servo.advance(now_ns); }
  bool inject(InjectedFault injected, bool begins, std::int64_t now_ns) LITHE_RT override;
  void to_start() LITHE_RT override { inside_.servo.to_start(); }

  // Power cycle: no answers and limp until `back_ns`, then stopped, with the stored settings.
  void restart(std::int64_t back_ns) LITHE_RT;

  Servo& servo() LITHE_RT { return inside_.servo; }
  const MoteusConfig& config() const LITHE_RT { return inside_.config; }

 private:
  enum class Access : std::uint32_t { done = 0, unknown = 1, read_only = 2 };  // the protocol's own error numbers

  bool serve(const Frame& request, Frame& answer) LITHE_RT;
  // False: the rest of the frame is left out.
  bool write(const moteus::Subframe& subframe, moteus::SubframeWriter& answer) LITHE_RT;
  bool read(const moteus::Subframe& subframe, moteus::SubframeWriter& answer) LITHE_RT;
  void stream(const moteus::Subframe& subframe, moteus::SubframeWriter& answer) LITHE_RT;

  // moteus_registers.cpp
  Access write_register(std::uint32_t number, double value) LITHE_RT;
  Access write_mode(double value) LITHE_RT;
  double* auxiliary(std::uint32_t number) LITHE_RT;
  // None: there is no such register, or not in this format.
  std::optional<double> read_register(std::uint32_t number, moteus::Format format) LITHE_RT;
  std::optional<double> status(std::uint32_t number) const LITHE_RT;
  std::optional<double> read_control(std::uint32_t number) const LITHE_RT;
  std::optional<double> read_ports(std::uint32_t number, moteus::Format format) const LITHE_RT;
  std::optional<double> read_identity(std::uint32_t number, moteus::Format format) const LITHE_RT;

  MoteusInside inside_;
  ServoCommand command_;  // as the registers stand now
  bool commanded_ = false;
  bool discarded_ = false;  // this frame is for a drive with another UUID
  moteus::Mode commanded_mode_ = moteus::Mode::stopped;
  bool homed_ = true;
  bool other_map_ = false;
  std::int64_t deaf_until_ns_ = std::numeric_limits<std::int64_t>::min();
  std::array<double, 2> gpio_{};
  std::array<double, 10> pwm_{};
  double clock_trim_ = 0;
  MoteusConsole console_;
};

// Of a robot file.
SimDevice make_sim_moteus(const SimPlace& place);
double moteus_torque_max_nm(const robot::DeviceConfig& device);

}  // namespace lithe::hal::sim
