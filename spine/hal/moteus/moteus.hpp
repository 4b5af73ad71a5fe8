// SPDX-License-Identifier: Apache-2.0
// The driver of one moteus: joint command to frame, frame to joint sample. No I/O: a bus carries the frames.
#pragma once

#include <cstdint>
#include <limits>
#include <optional>

#include "spine/core/rt.hpp"
#include "spine/hal/core/frame.hpp"
#include "spine/hal/core/drive.hpp"
#include "spine/hal/moteus/moteus_codec.hpp"
#include "spine/hal/moteus/moteus_setup.hpp"

namespace lithe::hal::moteus {

// How each number travels. Fewer bytes make shorter frames and coarser numbers: int16 tells positions to 1e-4 turns and
// only up to 3.27 of them, int8 to 0.01 and 1.27; torque to 0.01 and 0.5 Nm. As here: 48 bytes there, 24 back.
struct CommandFormats {
  Format position = Format::float32;
  Format velocity = Format::float32;
  Format torque = Format::float32;
  Format kp_scale = Format::float32;  // integers end at 1: no more than the gains that the drive is configured with
  Format kd_scale = Format::float32;
  Format max_torque = Format::float32;
  Format watchdog = Format::int16;
};
struct AnswerFormats {
  Format position = Format::float32;
  Format velocity = Format::float32;
  Format torque = Format::float32;
  // What the drive tells of itself beside its supply and temperature, which cost nothing; none: it is not asked.
  std::optional<Format> current = std::nullopt;
  std::optional<Format> power = std::nullopt;
};

struct DriverParams {
  std::uint32_t id = 1;     // 1 to 126
  double watchdog_s = 0.1;  // no command for this long, and the drive damps by itself
  JointTransform joint;
  // Of the joint: what `damp` is, and the least that every command carries. A drive whose watchdog runs out damps with
  // the gain scale of the last command it had (register 024), so that a torque command without one leaves the joint to
  // fall. 0: commands are sent as they are, and `damp` is what the drive is configured with.
  double damp_kd_nm_s_rad = 0.0;
  double velocity_max_rad_s = std::numeric_limits<double>::infinity();  // that the damping above is balanced up to
  // A drive calibrates before it drives, and hears commands meanwhile. From there on its torque limit grows by so much
  // in each exchange, so that the first torque the joint feels is no step.
  double torque_step_nm = std::numeric_limits<double>::infinity();
  // At the motor: what the drive may damp with when it is told to, or left alone (servo.timeout_max_torque_Nm). One
  // that is set to more is set to this at its set-up, until it is switched off.
  double damp_torque_max_nm = std::numeric_limits<double>::infinity();
  // Gains the drive itself is configured with: a command scales them.
  double kp_nm_rev = 4.0;
  double kd_nm_s_rev = 0.05;
  bool direct = false;        // nothing is geared, in the drive or behind it: the rotor's angle is the joint's
  bool ask_settings = false;  // the drive is asked for these three, and is not commanded before it has answered
  CommandFormats command{};
  AnswerFormats answer{};
  // The drive is configured with this watchdog time, without a planner and without an integral (Setup checks that), and
  // commands leave them out.
  bool settings_in_drive = false;
  // The largest gains that will be commanded, at the joint: what a format of whole numbers must be able to say.
  double kp_max_nm_rad = 0;
  double kd_max_nm_s_rad = 0;
};

// `frames` is a robot::FramesConfig, which this room does not know; its formats have the order of Format, then none.
template <class FramesConfig>
void use_frames(const FramesConfig& frames, DriverParams& params) {
  const auto format = [](auto which) { return static_cast<Format>(which); };
  const auto choice = [&format](auto which) {
    return which == decltype(which)::none ? std::optional<Format>() : std::optional<Format>(format(which));
  };
  const Format all = format(frames.command);
  params.command = {all, all, all, all, all, all, params.command.watchdog};
  params.answer = {format(frames.answer), format(frames.answer), format(frames.answer), choice(frames.current),
                   choice(frames.power)};
  params.settings_in_drive = frames.settings_in_drive;
}

// What Setup has to see in the drive before it may be commanded with these.
Expected expected_of(const DriverParams& params);

// What a drive said about its joint, in joint coordinates.
struct Answer {
  double position_rad = 0;
  double velocity_rad_s = 0;
  double torque_nm = 0;
  std::uint8_t mode = 0;
  std::uint8_t fault = 0;
  bool measured = false;  // the three above are finite and possible; a drive without an encoder answers NaN
  bool homed = false;     // the drive knows in which turn the joint is
  DriveReport drive{};
};

// wire::joint_status bits of an answer: fault, watchdog, not_homed, the fault code and the mode.
std::uint32_t status_of(const Answer& sample) LITHE_RT;

// The device that sent an answer, and the source address of the command it answers.
constexpr std::uint32_t device_of(const Frame& answer) LITHE_RT { return answer.id >> 8; }
constexpr std::uint32_t source_of(const Frame& answer) LITHE_RT { return answer.id & 0xff; }

// Every frame is a complete command (writing the mode resets all that was commanded before), carries its own watchdog
// and asks for the same answer, so that a lost frame loses nothing but itself.
// Contract: RT · pure · any thread
class Driver {
 public:
  explicit Driver(const DriverParams& params) : params_(params) {}

  std::uint32_t id() const LITHE_RT { return params_.id; }
  void know(const Settings& settings) LITHE_RT;

  // A number that is not finite never leaves here: the joint is damped instead, and false is returned.
  // `source` is our own address (0 to 127). The drive answers to it, so whoever changes it with every exchange knows an
  // answer that is late: nothing else in an answer tells which command it belongs to.
  // A position that its format cannot say is treated alike; other numbers are cut to what theirs can.
  // `measured_rad_s` is the joint's speed as it was heard last: at that speed, damping that is added adds no torque.
  bool encode(const JointCommand& command, std::uint32_t source, Frame& frame, double measured_rad_s = 0) const
      LITHE_RT;

  // The drive is off, and asked for what `setup` wants to know beside the usual.
  void encode_setup(Setup& setup, std::uint32_t source, Frame& frame) const LITHE_RT;

  // The joint moves freely between two positions, and is driven back from beyond them with the command's gains and
  // limits. Its position and velocity mean nothing here. NaN: no bound on that side.
  bool encode_within(const JointCommand& command, double lower_rad, double upper_rad, std::uint32_t source,
                     Frame& frame) const LITHE_RT;

  // False: not a whole answer of this drive; `sample` is unchanged. Whom it answers is left to the caller (source_of).
  bool decode(const Frame& frame, Answer& sample) const LITHE_RT;

 private:
  // In revolutions and torque of the motor, as the registers want them.
  struct MotorCommand {
    double position_rev, velocity_rev_s, torque_nm, kp_scale, kd_scale, max_torque_nm;
  };
  MotorCommand to_motor(const JointCommand& command, bool stiff) const LITHE_RT;
  double kd_scale(double kd_nm_s_rad) const LITHE_RT;
  JointCommand with_damping(const JointCommand& command, double measured_rad_s) const LITHE_RT;
  void write_torque(const JointCommand& command, SubframeWriter& writer) const LITHE_RT;
  void ask(std::uint32_t source, const AnswerFormats& as, SubframeWriter& writer, Frame& frame) const LITHE_RT;
  bool can_say(double position_rad) const LITHE_RT;

  DriverParams params_;
};

}  // namespace lithe::hal::moteus
