// SPDX-License-Identifier: Apache-2.0
// The registers of a simulated moteus: values and access rights.
#include <array>
#include <numbers>

#include "spine/hal/moteus/sim/sim_moteus.hpp"

namespace lithe::hal::sim {

using moteus::Format;
using moteus::Mode;
namespace reg = moteus::reg;

namespace {

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

bool within(std::uint32_t number, std::uint32_t first, std::size_t count) LITHE_RT { return number - first < count; }

// The field behind a command register; null when there is none.
double* field(ServoCommand& c, std::uint32_t number) LITHE_RT {
  constexpr std::uint32_t kFirstShadow = 0x042;
  if (within(number, kFirstShadow, kShadowed.size())) number = kShadowed[number - kFirstShadow];
  if (number >= reg::kCommandPosition && number <= reg::kIgnoreBounds)
    return &(c.*kCommands[number - reg::kCommandPosition]);
  if (number == reg::kCommandQCurrent) return &c.q_current_a;
  if (number == reg::kCommandDCurrent) return &c.d_current_a;
  if (number == reg::kLowerBound) return &c.lower_bound_rev;
  return number == reg::kUpperBound ? &c.upper_bound_rev : nullptr;
}

// The counter wraps at the end of its format; of 32 bits the smallest integer is a count, not NaN.
double wrapped_ms(std::int64_t ms, Format format) LITHE_RT {
  constexpr std::int64_t kExactInAFloat = 1 << 23;
  if (format == Format::float32) return static_cast<double>(ms % kExactInAFloat);
  if (format == Format::int32) return static_cast<std::int32_t>(ms);
  const bool byte = format == Format::int8;
  const double count = byte ? static_cast<std::int8_t>(ms) : static_cast<std::int16_t>(ms);
  return count == (byte ? -128 : -32768) ? kNotSet : count;
}

}  // namespace

SimMoteus::Access SimMoteus::write_register(std::uint32_t number, double value) LITHE_RT {
  if (number == reg::kMode) return write_mode(value);
  double* target = field(command_, number);
  if (target == nullptr) target = auxiliary(number);
  if (target != nullptr) {
    *target = value;
    return Access::done;
  }
  if (within(number, reg::kUuidMask, 4)) {
    discarded_ = discarded_ || value != inside_.identity.uuid_word(number - reg::kUuidMask);
    return Access::done;
  }
  if (number >= reg::kSetOutputNearest && number <= reg::kRecapture) {
    if (number == reg::kRequireReindex) inside_.servo.require_reindex();
    if (number == reg::kRecapture) inside_.servo.recapture();
    if (number <= reg::kSetOutputExact) inside_.servo.set_output(value, number == reg::kSetOutputExact);
    return Access::done;
  }
  return read_register(number, Format::int32) ? Access::read_only : Access::unknown;
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
  if (within(number, reg::kAuxGpioCommand, gpio_.size())) return &gpio_[number - reg::kAuxGpioCommand];
  if (within(number, reg::kAuxPwm, pwm_.size())) return &pwm_[number - reg::kAuxPwm];
  return number == reg::kClockTrim ? &clock_trim_ : nullptr;
}

std::optional<double> SimMoteus::read_register(std::uint32_t number, Format format) LITHE_RT {
  const double* source = field(command_, number);
  if (source == nullptr) source = auxiliary(number);
  if (source != nullptr) return *source;
  if (number < reg::kCommandPosition) return status(number);
  if (number < reg::kEncoder) return read_control(number);
  return number < reg::kModel ? read_ports(number, format) : read_identity(number, format);
}

std::optional<double> SimMoteus::status(std::uint32_t number) const LITHE_RT {
  const Servo& servo = inside_.servo;
  const ServoParams& params = servo.params();
  const double nm = servo.torque_nm(), rev = servo.position_rev(), rev_s = servo.velocity_rev_s();
  const double mode = static_cast<double>(servo.mode()), hot_c = params.temperature_c;
  const double q_a = nm / params.torque_constant_nm_a, power_w = nm * rev_s * 2 * std::numbers::pi;
  const double complete = servo.trajectory_complete() ? 1 : 0, home = homed_ ? servo.home() : 0;
  // From register 000 on; two are not there.
  const std::array<std::optional<double>, reg::kFault + 1> values{
      mode, rev, rev_s, nm, q_a, 0, rev, power_w, {}, {}, hot_c, complete, home, params.supply_v, hot_c, servo.fault()};
  return number < values.size() ? values[number] : std::nullopt;
}

std::optional<double> SimMoteus::read_control(std::uint32_t number) const LITHE_RT {
  const Servo& servo = inside_.servo;
  const auto& [p_nm, i_nm, d_nm, error_rev, error_rev_s] = servo.terms();
  const double nm = servo.control_torque_nm(), rev = servo.control_position_rev();
  const double fed_nm = servo.command().torque_nm, rev_s = servo.control_velocity_rev_s();
  const std::array<double, 14> values{p_nm, i_nm, d_nm,  fed_nm, nm,        0,           0,
                                      0,    rev,  rev_s, nm,     error_rev, error_rev_s, nm - servo.torque_nm()};
  const std::uint32_t at = number - reg::kTermP;
  if (number < reg::kTermP || at >= values.size() || (at > 4 && at < 8)) return std::nullopt;
  return values[at];
}

// One encoder, on the first port; nothing else is connected.
std::optional<double> SimMoteus::read_ports(std::uint32_t number, Format format) const LITHE_RT {
  const Servo& servo = inside_.servo;
  if (number == reg::kEncoder) return servo.position_rev();
  if (number == reg::kEncoder + 1) return servo.velocity_rev_s();
  if (number == reg::kEncoderValidity) return servo.encoder_lost() ? 0 : 3;
  if (within(number, reg::kAuxGpioStatus, gpio_.size())) return gpio_[number - reg::kAuxGpioStatus];
  if (number == reg::kMillisecondCounter) return wrapped_ms(servo.time_ns() / 1'000'000, format);
  // Of each port: period, duty cycle.
  if (within(number, reg::kPwmInput, 4)) return (number - reg::kPwmInput) % 2 == 0 ? 0 : kNotSet;
  const bool there =
      within(number, reg::kEncoder, 6) || within(number, reg::kAux1Analog, 5) || within(number, reg::kAux2Analog, 5);
  return there ? std::optional(0.0) : std::nullopt;
}

// Full 32-bit words are answered as int32 only.
std::optional<double> SimMoteus::read_identity(std::uint32_t number, Format format) const LITHE_RT {
  const MoteusIdentity& identity = inside_.identity;
  if (number == reg::kUuidMaskCapable) return 1;
  if (within(number, reg::kDriverFault, 2)) return 0;
  if (format != Format::int32) return std::nullopt;
  if (within(number, reg::kUuid, 4)) return identity.uuid_word(number - reg::kUuid);
  if (within(number, reg::kSerial, identity.serial.size()))
    return static_cast<std::int32_t>(identity.serial[number - reg::kSerial]);
  if (number == reg::kModel) return MoteusIdentity::kModel;
  if (number == reg::kFirmware) return MoteusIdentity::kFirmware;
  if (number == reg::kRegisterMap) return MoteusIdentity::kRegisterMap;
  return number == reg::kId ? std::optional<double>(inside_.config.id()) : std::nullopt;
}

}  // namespace lithe::hal::sim
