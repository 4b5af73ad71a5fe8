// SPDX-License-Identifier: Apache-2.0
// The registers of a simulated moteus: values and access rights.
#include <array>
#include <limits>
#include <numbers>

#include "spine/hal/moteus/sim/sim_moteus.hpp"

namespace lithe::hal::sim {

using moteus::Format;
using moteus::Mode;
namespace reg = moteus::reg;

namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// The stay_within registers from 042 on are aliases of these.
constexpr std::array<std::uint32_t, 7> kShadowed{reg::kCommandTorque, reg::kKpScale,  reg::kKdScale,
                                                 reg::kMaxTorque,     reg::kWatchdog, reg::kIntegralScale,
                                                 reg::kIgnoreBounds};

constexpr std::array kCommands{&ServoCommand::position_rev,
                               &ServoCommand::velocity_rev_s,
                               &ServoCommand::torque_nm,
                               &ServoCommand::kp_scale,
                               &ServoCommand::kd_scale,
                               &ServoCommand::max_torque_nm,
                               &ServoCommand::stop_position_rev,
                               &ServoCommand::watchdog_s,
                               &ServoCommand::velocity_limit_rev_s,
                               &ServoCommand::acceleration_limit_rev_s2,
                               &ServoCommand::fixed_voltage_v,
                               &ServoCommand::integral_scale,
                               &ServoCommand::fixed_current_a,
                               &ServoCommand::ignore_bounds};

// The field behind a command register; null when there is none.
double* field(ServoCommand& c, std::uint32_t number) LITHE_RT {
  constexpr std::uint32_t kFirstShadow = 0x042;
  if (number >= kFirstShadow && number - kFirstShadow < kShadowed.size()) number = kShadowed[number - kFirstShadow];
  if (number >= reg::kCommandPosition && number <= reg::kIgnoreBounds)
    return &(c.*kCommands[number - reg::kCommandPosition]);
  switch (number) {
    case reg::kCommandQCurrent:
      return &c.q_current_a;
    case reg::kCommandDCurrent:
      return &c.d_current_a;
    case reg::kLowerBound:
      return &c.lower_bound_rev;
    case reg::kUpperBound:
      return &c.upper_bound_rev;
    default:
      return nullptr;
  }
}

// The counter wraps at the end of its format; here the smallest integer is a count, not NaN.
double wrapped_ms(std::int64_t ms, Format format) LITHE_RT {
  switch (format) {
    case Format::int8: {
      const auto count = static_cast<std::int8_t>(ms);
      return count == std::numeric_limits<std::int8_t>::min() ? kNan : count;
    }
    case Format::int16: {
      const auto count = static_cast<std::int16_t>(ms);
      return count == std::numeric_limits<std::int16_t>::min() ? kNan : count;
    }
    case Format::int32:
      return static_cast<std::int32_t>(ms);
    case Format::float32:
      break;
  }
  constexpr std::int64_t kExactInAFloat = 1 << 23;
  return static_cast<double>(ms % kExactInAFloat);
}

}  // namespace

SimMoteus::Access SimMoteus::write_register(std::uint32_t number, double value) LITHE_RT {
  if (number == reg::kMode) return write_mode(value);
  if (double* target = field(command_, number)) {
    *target = value;
    return Access::done;
  }
  if (double* target = auxiliary(number)) {
    *target = value;
    return Access::done;
  }
  if (number >= reg::kUuidMask && number < reg::kUuidMask + 4) {
    discarded_ = discarded_ || value != inside_.identity.uuid_word(number - reg::kUuidMask);
    return Access::done;
  }
  switch (number) {
    case reg::kSetOutputNearest:
    case reg::kSetOutputExact:
      inside_.servo.set_output(value, number == reg::kSetOutputExact);
      return Access::done;
    case reg::kRequireReindex:
      inside_.servo.require_reindex();
      return Access::done;
    case reg::kRecapture:
      inside_.servo.recapture();
      return Access::done;
    default:
      break;
  }
  double unused = 0;
  return read_register(number, Format::int32, unused) ? Access::read_only : Access::unknown;
}

SimMoteus::Access SimMoteus::write_mode(double value) LITHE_RT {
  if (!(value >= 0 && value <= 15)) return Access::unknown;
  const Mode mode = static_cast<Mode>(static_cast<std::uint8_t>(value));
  if (mode >= Mode::fault && mode <= Mode::calibration_complete) return Access::done;  // ignored
  const bool simulated =
      mode == Mode::stopped || mode == Mode::brake || (mode >= Mode::current && mode <= Mode::stay_within);
  if (!simulated) return Access::unknown;
  command_ = ServoCommand{};
  commanded_ = true;
  commanded_mode_ = mode;
  return Access::done;
}

// Registers that only store the written value: clock trim and the outputs of the auxiliary ports.
double* SimMoteus::auxiliary(std::uint32_t number) LITHE_RT {
  if (number == reg::kAuxGpioCommand || number == reg::kAuxGpioCommand + 1)
    return &gpio_[number - reg::kAuxGpioCommand];
  if (number >= reg::kAuxPwm && number < reg::kAuxPwm + pwm_.size()) return &pwm_[number - reg::kAuxPwm];
  return number == reg::kClockTrim ? &clock_trim_ : nullptr;
}

bool SimMoteus::read_register(std::uint32_t number, Format format, double& value) LITHE_RT {
  const double* source = field(command_, number);
  if (source == nullptr) source = auxiliary(number);
  if (source != nullptr) {
    value = *source;
    return true;
  }
  if (number < reg::kCommandPosition) {
    const std::optional<double> known = status(number);
    value = known.value_or(0);
    return known.has_value();
  }
  if (number < reg::kEncoder) return read_control(number, value);
  if (number < reg::kModel) return read_ports(number, format, value);
  return read_identity(number, format, value);
}

std::optional<double> SimMoteus::status(std::uint32_t number) const LITHE_RT {
  const Servo& servo = inside_.servo;
  const ServoParams& params = servo.params();
  switch (number) {
    case reg::kMode:
      return static_cast<double>(servo.mode());
    case reg::kPosition:
    case reg::kAbsPosition:
      return servo.position_rev();
    case reg::kVelocity:
      return servo.velocity_rev_s();
    case reg::kTorque:
      return servo.torque_nm();
    case reg::kQCurrent:
      return servo.torque_nm() / params.torque_constant_nm_a;
    case reg::kDCurrent:
      return 0;
    case reg::kPower:
      return servo.torque_nm() * servo.velocity_rev_s() * 2 * std::numbers::pi;
    case reg::kMotorTemperature:
    case reg::kTemperature:
      return params.temperature_c;
    case reg::kTrajectoryComplete:
      return servo.trajectory_complete() ? 1 : 0;
    case reg::kHomeState:
      return homed_ ? servo.home() : 0;
    case reg::kVoltage:
      return params.supply_v;
    case reg::kFault:
      return servo.fault();
    default:
      return std::nullopt;
  }
}

bool SimMoteus::read_control(std::uint32_t number, double& value) LITHE_RT {
  const Servo& servo = inside_.servo;
  const Servo::Terms& terms = servo.terms();
  const std::array<double, 14> values{terms.p_nm,
                                      terms.i_nm,
                                      terms.d_nm,
                                      servo.command().torque_nm,
                                      servo.control_torque_nm(),
                                      0,
                                      0,
                                      0,
                                      servo.control_position_rev(),
                                      servo.control_velocity_rev_s(),
                                      servo.control_torque_nm(),
                                      terms.error_rev,
                                      terms.error_rev_s,
                                      servo.control_torque_nm() - servo.torque_nm()};
  const std::uint32_t at = number - reg::kTermP;
  if (number < reg::kTermP || at >= values.size() || (at > 4 && at < 8)) return false;
  value = values[at];
  return true;
}

// One encoder, on the first port; nothing else is connected.
bool SimMoteus::read_ports(std::uint32_t number, Format format, double& value) LITHE_RT {
  const Servo& servo = inside_.servo;
  value = 0;
  if (number < reg::kEncoder + 6) {
    if (number == reg::kEncoder) value = servo.position_rev();
    if (number == reg::kEncoder + 1) value = servo.velocity_rev_s();
    return true;
  }
  if (number == reg::kEncoderValidity) {
    value = servo.encoder_lost() ? 0 : 3;
    return true;
  }
  if (number == reg::kAuxGpioStatus || number == reg::kAuxGpioStatus + 1) {
    value = gpio_[number - reg::kAuxGpioStatus];
    return true;
  }
  if (number == reg::kMillisecondCounter) {
    value = wrapped_ms(servo.time_ns() / 1'000'000, format);
    return true;
  }
  if (number >= reg::kPwmInput && number < reg::kPwmInput + 4) {
    value = (number - reg::kPwmInput) % 2 == 0 ? 0 : kNan;  // period, duty cycle
    return true;
  }
  return (number >= reg::kAux1Analog && number < reg::kAux1Analog + 5) ||
         (number >= reg::kAux2Analog && number < reg::kAux2Analog + 5);
}

// Full 32-bit words are answered as int32 only.
bool SimMoteus::read_identity(std::uint32_t number, Format format, double& value) LITHE_RT {
  const MoteusIdentity& identity = inside_.identity;
  if (number == reg::kUuidMaskCapable || number == reg::kDriverFault || number == reg::kDriverFault + 1) {
    value = number == reg::kUuidMaskCapable ? 1 : 0;
    return true;
  }
  if (format != Format::int32) return false;
  if (number >= reg::kUuid && number < reg::kUuid + 4) {
    value = identity.uuid_word(number - reg::kUuid);
    return true;
  }
  if (number >= reg::kSerial && number < reg::kSerial + identity.serial.size()) {
    value = static_cast<std::int32_t>(identity.serial[number - reg::kSerial]);
    return true;
  }
  if (number == reg::kModel) value = MoteusIdentity::kModel;
  if (number == reg::kFirmware) value = MoteusIdentity::kFirmware;
  if (number == reg::kRegisterMap) value = MoteusIdentity::kRegisterMap;
  if (number == reg::kId) value = inside_.config.id();
  return (number >= reg::kModel && number <= reg::kRegisterMap) || number == reg::kId;
}

}  // namespace lithe::hal::sim
