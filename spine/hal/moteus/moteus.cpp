// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/moteus/moteus.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <limits>
#include <span>

#include "spine/wire/wire.hpp"

namespace lithe::hal::moteus {
namespace {

// Plausibility limits of an answer: the drive counts +-32768 turns, and no motor has that torque.
constexpr double kMaxRev = 32768;
constexpr double kMaxTorqueNm = 1000;
// Limit for values of a command: beyond it, products of two values do not fit a float.
constexpr double kMaxCommand = 1e15;

// False also for NaN and infinity.
bool possible(double value) LITHE_RT { return std::abs(value) <= kMaxCommand; }

bool possible(const JointCommand& c) LITHE_RT {
  return possible(c.torque_nm) && possible(c.target_rad_s) && possible(c.kp_nm_rad) && possible(c.kd_nm_s_rad) &&
         possible(c.max_torque_nm) && (!has_target(c.target_rad) || possible(c.target_rad));
}

// Torque at the motor per revolution of the motor, from torque at the joint per radian of the joint.
double to_motor_gain(const JointTransform& joint) LITHE_RT {
  return 2 * std::numbers::pi / (joint.ratio * joint.ratio);
}

Mode mode_for(DriveAction action) LITHE_RT {
  if (action == DriveAction::torque) return Mode::position;  // has a watchdog, unlike the current mode
  if (action == DriveAction::damp) return Mode::zero_velocity;
  return action == DriveAction::brake ? Mode::brake : Mode::stopped;
}

// The registers of an answer, by number; NaN until received.
class Registers {
 public:
  Registers() LITHE_RT { values_.fill(std::numeric_limits<double>::quiet_NaN()); }

  void set(std::uint32_t number, double value) LITHE_RT {
    if (number < values_.size()) values_[number] = value;
  }
  double operator[](std::uint32_t number) const LITHE_RT { return values_[number]; }

  // NaN compares false: a missing register makes the answer invalid.
  bool whole() const LITHE_RT {
    return values_[reg::kMode] >= 0 && values_[reg::kMode] <= 15 && values_[reg::kFault] >= 0;
  }
  bool measured() const LITHE_RT {
    const double torque_nm = values_[reg::kTorque];
    return std::abs(values_[reg::kPosition]) <= kMaxRev && std::abs(values_[reg::kVelocity]) <= kMaxMotorRevPerS &&
           std::abs(torque_nm) <= kMaxTorqueNm;
  }

 private:
  std::array<double, reg::kFault + 1> values_;
};

wire::DriveState state_of(Mode mode) LITHE_RT {
  if (mode == Mode::stopped) return wire::DriveState::off;
  if (mode == Mode::fault) return wire::DriveState::fault;
  if (mode <= Mode::calibration_complete) return wire::DriveState::enabling;
  const bool damped = mode == Mode::timeout || mode == Mode::zero_velocity || mode == Mode::brake;
  return damped ? wire::DriveState::damped : wire::DriveState::driven;
}

// wire::joint_status bits: fault, watchdog, not_homed, the fault code and the mode.
std::uint32_t status_of(Mode mode, double fault, bool homed) LITHE_RT {
  const auto code = static_cast<std::uint32_t>(std::min(fault, 255.0));
  std::uint32_t status = code << 8 | std::uint32_t{static_cast<std::uint8_t>(mode)} << 16;
  // A fault code alone is not a fault: while a limit is active, the code names it and the drive continues.
  if (mode == Mode::fault) status |= wire::joint_status::kFault;
  if (mode == Mode::timeout) status |= wire::joint_status::kWatchdog;
  if (!homed) status |= wire::joint_status::kNotHomed;
  return status;
}

// A value that is not finite, or does not fit a float, is reported as NaN.
double told(double value) LITHE_RT { return possible(value) ? value : DriveReport::kNotReported; }

}  // namespace

Expected expected_of(const DriverParams& params) {
  Expected expected;
  expected.settings = params.frames.settings_in_drive;
  expected.watchdog_s = params.watchdog_s;
  expected.may_hold = params.may_hold_alone;
  // An integer format ends at a scale of 1, the drive's configured gain.
  if (params.frames.command != Format::float32) {
    const double least = to_motor_gain(params.joint);
    expected.least_kp_nm_rev = least * params.kp_max_nm_rad;
    expected.least_kd_nm_s_rev = least * std::max(params.kd_max_nm_s_rad, params.damp_kd_nm_s_rad);
  }
  expected.damp_torque_max_nm = params.damp_torque_max_nm;
  if (std::isfinite(params.damp_torque_max_nm)) {
    const int length = std::snprintf(expected.damp_line.data(), expected.damp_line.size(),
                                     "conf set servo.timeout_max_torque_Nm %.6g\n", params.damp_torque_max_nm);
    expected.damp_line_length = std::min(static_cast<std::size_t>(std::max(length, 0)), expected.damp_line.size() - 1);
  }
  return expected;
}

MoteusDrive::MoteusDrive(const DriverParams& params)
    : params_(params), setup_(expected_of(params)), torque_allowed_nm_(params.torque_step_nm) {
  tell();
}

bool MoteusDrive::can_say(double position_rad) const LITHE_RT {
  const double position_rev = std::abs(params_.joint.motor_rev(position_rad));
  return !has_target(position_rad) || position_rev <= largest(Quantity::position_rev, params_.frames.command);
}

MoteusDrive::MotorCommand MoteusDrive::to_motor(const JointCommand& command) const LITHE_RT {
  const JointTransform& joint = params_.joint;
  const double kp = has_target(command.target_rad) ? std::max(command.kp_nm_rad, 0.0) : 0.0;
  return {joint.motor_rev(command.target_rad), command.target_rad_s * joint.rev_per_rad(),
          command.torque_nm / joint.gear(),    kp * to_motor_gain(joint) / params_.kp_nm_rev,
          kd_scale(command.kd_nm_s_rad),       std::max(command.max_torque_nm, 0.0) / joint.ratio};
}

double MoteusDrive::kd_scale(double kd_nm_s_rad) const LITHE_RT {
  return std::max(kd_nm_s_rad, 0.0) * to_motor_gain(params_.joint) / params_.kd_nm_s_rev;
}

// The same torque at the measured speed, plus the damping that must remain when this computer dies.
JointCommand MoteusDrive::with_damping(const JointCommand& command, double measured_rad_s) const LITHE_RT {
  JointCommand damped = command;
  const double kd = std::max(command.kd_nm_s_rad, 0.0);
  if (kd >= params_.damp_kd_nm_s_rad) return damped;
  // An implausible velocity must not change the torque.
  const double at_rad_s = std::clamp(measured_rad_s, -params_.velocity_max_rad_s, params_.velocity_max_rad_s);
  damped.kd_nm_s_rad = params_.damp_kd_nm_s_rad;
  damped.torque_nm += (kd - damped.kd_nm_s_rad) * (command.target_rad_s - at_rad_s);
  return damped;
}

void MoteusDrive::know(const Settings& settings) LITHE_RT {
  params_.kp_nm_rev = settings.kp_nm_rev;
  params_.kd_nm_s_rev = settings.kd_nm_s_rev;
  params_.direct = settings.rotor_to_output_ratio == 1.0 && params_.joint.ratio == 1.0;
}

bool MoteusDrive::encode(const JointCommand& command, std::uint32_t source, Frame& frame, double measured_rad_s) const
    LITHE_RT {
  const bool sound = command.action != DriveAction::torque || (possible(command) && can_say(command.target_rad));
  const DriveAction action = sound ? command.action : DriveAction::damp;
  SubframeWriter writer(frame);
  const std::array<double, 1> mode{static_cast<double>(mode_for(action))};
  writer.write(Format::int8, reg::kMode, mode);
  if (action == DriveAction::torque) write_torque(with_damping(command, measured_rad_s), writer);
  if (action == DriveAction::damp && params_.damp_kd_nm_s_rad > 0)
    writer.write(params_.frames.command, reg::kKdScale, std::array{kd_scale(params_.damp_kd_nm_s_rad)});
  ask(source, params_.frames, writer, frame);
  writer.pad();
  return sound && writer.ok();
}

// Commands "off", and asks the next question of the set-up in addition to the usual query.
void MoteusDrive::encode_setup(std::uint32_t source, Frame& frame) LITHE_RT {
  SubframeWriter writer(frame);
  writer.write(Format::int8, reg::kMode, std::array{static_cast<double>(Mode::stopped)});
  FrameKeys without = params_.frames;  // leaves room for the console's answer
  without.current.reset();
  without.power.reset();
  ask(source, without, writer, frame);
  setup_.ask(writer);
  writer.pad();
}

// The address and the query of every frame.
void MoteusDrive::ask(std::uint32_t source, const FrameKeys& as, SubframeWriter& writer, Frame& frame) const LITHE_RT {
  frame.id = kReplyRequested | (source & 0x7f) << 8 | params_.id;
  frame.extended = true;
  frame.fd = true;
  frame.brs = true;
  // Between current and power there are two unused registers. The mode in the format of what follows it where both fit
  // a subframe: then the frames are shorter by four bytes.
  const Format mode = as.answer == Format::int16 ? Format::int16 : Format::int8;
  const std::array<SubframeWriter::Choice, 8> motion{mode,       as.answer,    as.answer,    as.answer,
                                                     as.current, std::nullopt, std::nullopt, as.power};
  writer.read_each(reg::kMode, motion);
  // Four registers to the fault: the home state costs nothing, with it the answer fills its 24 bytes exactly.
  writer.read(Format::int8, reg::kHomeState, 4);
}

void MoteusDrive::write_torque(const JointCommand& command, SubframeWriter& writer) const LITHE_RT {
  const MotorCommand motor = to_motor(command);
  const std::array<double, 6> values{motor.position_rev, motor.velocity_rev_s, motor.torque_nm,
                                     motor.kp_scale,     motor.kd_scale,       motor.max_torque_nm};
  writer.write(params_.frames.command, reg::kCommandPosition, values);
  if (params_.frames.settings_in_drive) return;
  // The drive's own planner would smooth what is already planned here: a negative limit switches its planner off.
  // Fields: watchdog, limits of velocity and acceleration, unused fixed voltage, integral.
  const std::array<SubframeWriter::Choice, 5> how{Format::int16, Format::int8, Format::int8, std::nullopt,
                                                  Format::int8};
  const std::array<double, 5> rest{params_.watchdog_s, -1, -1, 0, 0};
  writer.write_each(reg::kWatchdog, how, rest);
}

bool MoteusDrive::decode(const Frame& frame, JointSample& sample) const LITHE_RT {
  if (device_of(frame) != params_.id) return false;
  Registers answer;
  SubframeReader reader(frame.payload());
  Subframe subframe;
  while (reader.next(subframe)) {
    if (subframe.kind != Kind::reply) continue;
    for (std::uint32_t i = 0; i < subframe.count; ++i) answer.set(subframe.start + i, subframe.value(i));
  }
  if (!reader.well_formed() || !answer.whole()) return false;
  const Mode mode = static_cast<Mode>(static_cast<std::uint8_t>(answer[reg::kMode]));
  // Behind a gear, a rotor's absolute encoder (1) does not tell the turn; an output encoder or a homing (2) does.
  sample.status = status_of(mode, answer[reg::kFault], answer[reg::kHomeState] >= (params_.direct ? 1 : 2));
  const double sign = params_.joint.gear() < 0 ? -1 : 1;
  sample.drive = {state_of(mode), sign * told(answer[reg::kQCurrent]), told(answer[reg::kVoltage]),
                  told(answer[reg::kPower]), told(answer[reg::kTemperature])};
  const double rev = answer[reg::kPosition], rev_s = answer[reg::kVelocity], nm = answer[reg::kTorque];
  // An integer at the end of its range is not a measurement.
  sample.measured = answer.measured() && std::abs(rev) < largest(Quantity::position_rev, params_.frames.answer) &&
                    std::abs(rev_s) < largest(Quantity::velocity_rev_s, params_.frames.answer) &&
                    std::abs(nm) < largest(Quantity::torque_nm, params_.frames.answer);
  if (!sample.measured) return true;
  sample.position_rad = params_.joint.position_rad(rev);
  sample.velocity_rad_s = rev_s / params_.joint.rev_per_rad();
  sample.torque_nm = nm * params_.joint.gear();
  return true;
}

bool MoteusDrive::command(const JointCommand& command, const Exchange& exchange, Bus& bus) LITHE_RT {
  if (unanswered_ == kForgets) forgotten_ = true;
  if (unanswered_ <= kForgets) ++unanswered_;
  if (forgotten_ && command.action == DriveAction::off) {
    setup_.restart();
    forgotten_ = false;
    tell();
  }
  Frame frame;
  bool sound = true;
  if (ready()) {
    JointCommand eased = command;
    // Non-finite values are kept, so that the driver detects them.
    if (std::isfinite(command.max_torque_nm)) eased.max_torque_nm = std::min(command.max_torque_nm, torque_allowed_nm_);
    sound = encode(eased, exchange.source, frame, velocity_rad_s_);
    asked_ = false;
  } else {
    if (asked_) setup_.missed();
    encode_setup(exchange.source, frame);
    asked_ = true;
  }
  bus.send(frame);  // a refusal is counted by the bus, and the answer is missed
  return sound;
}

ReplyKind MoteusDrive::on_frame(const Frame& frame, const Exchange& exchange, JointSample& sample) LITHE_RT {
  if (!exchange.asked || source_of(frame) != exchange.source) return ReplyKind::late;
  if (!decode(frame, sample)) return ReplyKind::malformed;
  unanswered_ = 0;
  if (asked_) {
    asked_ = false;  // a duplicate frame is used once
    setup_.on_frame(frame);
    if (setup_.ready()) know(setup_.settings());
    tell();
  }
  const bool drives = mode_of(sample.status) == Mode::position;
  torque_allowed_nm_ = drives ? torque_allowed_nm_ + params_.torque_step_nm : params_.torque_step_nm;
  if (sample.measured) velocity_rad_s_ = sample.velocity_rad_s;
  if (!ready()) sample.status |= wire::joint_status::kNotReady;
  return ReplyKind::answer;
}

namespace {

// The length of the answer follows from the registers that the command reads.
std::size_t answer_size(const Frame& command) {
  Frame answer;
  SubframeWriter writer(answer);
  SubframeReader reader(command.payload());
  Subframe subframe;
  constexpr std::array<double, kMaxPayload> kZeros{};
  while (reader.next(subframe)) {
    if (subframe.kind != Kind::read || subframe.count > kZeros.size()) continue;
    writer.reply(subframe.format, subframe.start, std::span(kZeros).first(subframe.count), subframe.long_form);
  }
  writer.pad();
  return answer.size;
}

}  // namespace

std::unique_ptr<Drive> make_drive(const robot::RobotConfig& robot, const robot::JointConfig& joint) {
  const robot::DeviceConfig& device = robot.devices[joint.device];
  DriverParams params;
  params.id = device.id;
  params.watchdog_s = device.watchdog_s;
  params.joint = {joint.sign, joint.zero_rad, joint.ratio};
  params.damp_kd_nm_s_rad = joint.safe_kd_nm_s_rad;
  params.damp_torque_max_nm = joint.torque_max_nm / joint.ratio;
  params.velocity_max_rad_s = joint.velocity_max_rad_s;
  params.torque_step_nm = joint.torque_slew_nm_s * device.rate_divider / robot.rate_hz;
  params.may_hold_alone = device.keys.moteus.may_hold_alone;
  params.ask_settings = true;
  params.kp_max_nm_rad = joint.kp_max_nm_rad;
  params.kd_max_nm_s_rad = joint.kd_max_nm_s_rad;
  params.frames = device.keys.moteus.frames;
  return std::make_unique<MoteusDrive>(params);
}

PlannedFrames planned_frames(const robot::DeviceConfig& device, const robot::BusConfig& /*bus*/) {
  DriverParams params;
  params.id = device.id;
  params.watchdog_s = device.watchdog_s;
  params.frames = device.keys.moteus.frames;
  const MoteusDrive driver(params);
  JointCommand command;
  command.action = DriveAction::torque;  // the longest
  Frame frame;
  driver.encode(command, 0, frame);
  const double rate = 1.0 / device.rate_divider;
  // Our source address, in every second value from 0 to 126, is bits 8 to 14 of a command and 0 to 6 of an answer.
  return {{.what = "command",
           .size = frame.size,
           .id = 0x8000 | device.id,
           .fd = true,
           .outbound = true,
           .per_tick = rate,
           .id_step = 0x200,
           .id_wrap = 0x8000},
          {.what = "answer",
           .size = answer_size(frame),
           .id = device.id << 8,
           .fd = true,
           .per_tick = rate,
           .id_step = 2,
           .id_wrap = 0x80}};
}

std::string state_words(std::uint32_t mode, std::uint32_t code) {
  std::string words = mode_name(static_cast<Mode>(mode));
  if (code == 0) return words;
  if (is_limit(code)) words += ", at its limit";
  return words + ": " + fault_name(code) + " (" + std::to_string(code) + ")";
}

}  // namespace lithe::hal::moteus
