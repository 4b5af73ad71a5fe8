// SPDX-License-Identifier: Apache-2.0
// The driver of one moteus: implements hal::Drive.
#pragma once

#include <atomic>
#include <cstdint>
#include <limits>
#include <memory>
#include <string>

#include "spine/core/rt.hpp"
#include "spine/hal/core/bus_tools.hpp"
#include "spine/hal/core/drive.hpp"
#include "spine/hal/core/frame.hpp"
#include "spine/hal/moteus/moteus_codec.hpp"
#include "spine/hal/moteus/moteus_setup.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal::moteus {

struct DriverParams {
  std::uint32_t id = 1;     // 1 to 126
  double watchdog_s = 0.1;  // without a command for this long the drive damps by itself
  JointTransform joint;
  // At the joint: the damping of `damp`, and the minimum damping in every command. After a watchdog timeout the drive
  // damps with the gain scale of its last command (register 024), so without damping in the command the joint would
  // fall. 0: commands are sent unchanged, and `damp` uses the drive's own setting.
  double damp_kd_nm_s_rad = 0.0;
  double velocity_max_rad_s = std::numeric_limits<double>::infinity();  // the damping is compensated up to this
  double torque_step_nm = std::numeric_limits<double>::infinity();
  // At the motor: largest damping torque after `damp` or a watchdog timeout (servo.timeout_max_torque_Nm). A larger
  // setting is reduced to this at set-up, until the drive is switched off.
  double damp_torque_max_nm = std::numeric_limits<double>::infinity();
  bool may_hold_alone = false;  // a drive with servo.timeout_mode 10 may be commanded
  // Gains the drive itself is configured with: a command scales them.
  double kp_nm_rev = 4.0;
  double kd_nm_s_rev = 0.05;
  bool direct = false;        // no gear in the drive or behind it: the rotor's angle is the joint's
  bool ask_settings = false;  // read these three from the drive before it is commanded
  // By default 48 bytes out, 24 back. `settings_in_drive`: the drive is configured with this watchdog time, without a
  // planner and without an integral (Setup checks that), and commands leave them out.
  FrameKeys frames{};
  // The largest gains that will be commanded, at the joint: an integer format must be able to represent them.
  double kp_max_nm_rad = 0;
  double kd_max_nm_s_rad = 0;
};

// The settings that Setup must find in the drive before it may be commanded with these parameters.
Expected expected_of(const DriverParams& params);

// The mode in a joint's status.
constexpr Mode mode_of(std::uint32_t status) LITHE_RT { return static_cast<Mode>(status >> 16 & 0xff); }

// The device that sent an answer, and the source address of the command it answers.
constexpr std::uint32_t device_of(const Frame& answer) LITHE_RT { return answer.id >> 8; }
constexpr std::uint32_t source_of(const Frame& answer) LITHE_RT { return answer.id & 0xff; }

// One command and one answer per exchange. Every frame is a complete command (writing the mode resets all that was
// commanded before), carries its own watchdog and asks for the same answer, so that a lost frame has no further effect.
// With DriverParams::ask_settings the drive's settings are read first (Setup): until then it answers, but is off and
// not ready. The settings are read again when it is off and was silent for a while: it may have been replaced.
// Contract: as hal::Drive; why_not_ready() any thread; encode, decode: pure
class MoteusDrive final : public Drive {
 public:
  explicit MoteusDrive(const DriverParams& params);

  bool command(const JointCommand& command, const Exchange& exchange, Bus& bus) LITHE_RT override;
  ReplyKind on_frame(const Frame& frame, const Exchange& exchange, JointSample& sample) LITHE_RT override;
  // Relaxed: the word is self-contained. Pairs with tell().
  std::string why_not_ready() const override { return describe_not_ready(not_ready_.load(std::memory_order_relaxed)); }

  // The frame of one command. A value that is not finite is never sent: the joint is damped instead, and false is
  // returned. `source` is our own address (0 to 127). The drive answers to it, so a caller that changes it with every
  // exchange can recognise a late answer: nothing else in an answer shows which command it belongs to. A position
  // outside its format is treated like a non-finite value; other values are clipped to their formats. `measured_rad_s`
  // is the joint's last measured velocity: at that velocity the added damping adds no torque.
  bool encode(const JointCommand& command, std::uint32_t source, Frame& frame, double measured_rad_s = 0) const
      LITHE_RT;
  // False: not a valid answer of this drive; `sample` is unchanged. The caller checks which command it answers
  // (source_of). A drive without an encoder answers NaN: not measured.
  bool decode(const Frame& frame, JointSample& sample) const LITHE_RT;
  // The settings that the drive has said.
  void know(const Settings& settings) LITHE_RT;

 private:
  // In revolutions and torque of the motor, as the registers want them.
  struct MotorCommand {
    double position_rev, velocity_rev_s, torque_nm, kp_scale, kd_scale, max_torque_nm;
  };
  MotorCommand to_motor(const JointCommand& command) const LITHE_RT;
  double kd_scale(double kd_nm_s_rad) const LITHE_RT;
  JointCommand with_damping(const JointCommand& command, double measured_rad_s) const LITHE_RT;
  void write_torque(const JointCommand& command, SubframeWriter& writer) const LITHE_RT;
  void ask(std::uint32_t source, const FrameKeys& as, SubframeWriter& writer, Frame& frame) const LITHE_RT;
  bool can_say(double position_rad) const LITHE_RT;
  void encode_setup(std::uint32_t source, Frame& frame) LITHE_RT;
  bool ready() const LITHE_RT { return !params_.ask_settings || setup_.ready(); }
  // Relaxed: the word is self-contained. Pairs with why_not_ready().
  void tell() LITHE_RT { not_ready_.store(params_.ask_settings ? setup_.packed() : 0, std::memory_order_relaxed); }

  static constexpr std::uint32_t kForgets = 10;  // exchanges without an answer

  DriverParams params_;
  Setup setup_;
  bool asked_ = false;                      // this exchange's frame contained a Setup question
  std::uint32_t unanswered_ = 0;            // exchanges in a row
  bool forgotten_ = false;                  // it was silent for kForgets exchanges: read the settings again
  double velocity_rad_s_ = 0;               // last measured
  double torque_allowed_nm_;                // its torque limit while it grows after calibration
  std::atomic<std::uint64_t> not_ready_{};  // Setup::packed(); stored by the exchange's thread, loaded by any
};

// Of a robot file: what the registry's row needs of it.
std::unique_ptr<Drive> make_drive(const robot::RobotConfig& robot, const robot::JointConfig& joint);
// The driver's own command, and the answer to it.
PlannedFrames planned_frames(const robot::DeviceConfig& device, const robot::BusConfig& bus);
std::unique_ptr<Scanner> make_scanner();
// Any bytes are safe.
FrameText frame_text(const Frame& frame, const FrameContext& context);
// For example "fault: over-temperature (38)".
std::string state_words(std::uint32_t mode, std::uint32_t code);

}  // namespace lithe::hal::moteus
