// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/sim/sim_moteus.hpp"

#include <array>
#include <numbers>

namespace lithe::hal::sim {

using moteus::Kind;
using moteus::Mode;
using moteus::Subframe;
using moteus::SubframeReader;
using moteus::SubframeWriter;
namespace reg = moteus::reg;

namespace {

constexpr std::uint32_t kReplyRequested = 0x8000;
constexpr std::uint32_t kBroadcast = 0x7f;
constexpr std::uint32_t kLargestStandardId = 0x7ff;

// The registers of stay_within from 042 on are other names of these.
constexpr std::array<std::uint32_t, 7> kShadowed{reg::kCommandTorque, reg::kKpScale,  reg::kKdScale,
                                                 reg::kMaxTorque,     reg::kWatchdog, reg::kIntegralScale,
                                                 reg::kIgnoreBounds};

// The field behind a command register; null when there is none.
double* field(ServoCommand& c, std::uint32_t number) LITHE_RT {
  constexpr std::uint32_t kFirstShadow = 0x042;
  if (number >= kFirstShadow && number - kFirstShadow < kShadowed.size()) number = kShadowed[number - kFirstShadow];
  switch (number) {
    case reg::kCommandQCurrent:
      return &c.q_current_a;
    case reg::kCommandDCurrent:
      return &c.d_current_a;
    case reg::kCommandPosition:
      return &c.position_rev;
    case reg::kCommandVelocity:
      return &c.velocity_rev_s;
    case reg::kCommandTorque:
      return &c.torque_nm;
    case reg::kKpScale:
      return &c.kp_scale;
    case reg::kKdScale:
      return &c.kd_scale;
    case reg::kMaxTorque:
      return &c.max_torque_nm;
    case reg::kStopPosition:
      return &c.stop_position_rev;
    case reg::kWatchdog:
      return &c.watchdog_s;
    case reg::kVelocityLimit:
      return &c.velocity_limit_rev_s;
    case reg::kAccelerationLimit:
      return &c.acceleration_limit_rev_s2;
    case reg::kFixedVoltage:
      return &c.fixed_voltage_v;
    case reg::kIntegralScale:
      return &c.integral_scale;
    case reg::kFixedCurrent:
      return &c.fixed_current_a;
    case reg::kIgnoreBounds:
      return &c.ignore_bounds;
    case reg::kLowerBound:
      return &c.lower_bound_rev;
    case reg::kUpperBound:
      return &c.upper_bound_rev;
    default:
      return nullptr;
  }
}

}  // namespace

void SimMoteus::on_frame(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT {
  const std::uint32_t destination = frame.id & 0xff;
  const bool prefixed = (frame.id >> 16) != 0;
  if (prefixed || (destination != id_ && destination != kBroadcast)) return;
  servo_.advance(now_ns);
  Frame answer;
  commanded_ = false;
  serve(frame, answer);
  if (commanded_) servo_.apply(commanded_mode_, command_);
  if ((frame.id & kReplyRequested) == 0) return;
  answer.id = id_ << 8 | ((frame.id >> 8) & 0x7f);
  answer.extended = answer.id > kLargestStandardId;
  answer.brs = frame.brs;
  answer.fd = frame.fd || answer.size > 8;
  answers.push(answer);
}

void SimMoteus::serve(const Frame& request, Frame& answer) LITHE_RT {
  SubframeWriter writer(answer);
  SubframeReader reader(request.payload());
  Subframe subframe;
  bool going = true;
  while (going && reader.next(subframe)) {
    switch (subframe.kind) {
      case Kind::write:
        write(subframe, writer);
        break;
      case Kind::read:
        going = read(subframe, writer);
        break;
      case Kind::client_data:
      case Kind::poll:
        writer.empty_server_data(subframe.start);  // no console behind it
        break;
      case Kind::reply:
      case Kind::write_error:
      case Kind::read_error:
      case Kind::server_data:
        going = false;  // not for a drive
        break;
    }
  }
  writer.pad();
  // Some readers of an empty answer fail; a byte that means nothing is as good.
  if (answer.size == 0) {
    answer.data[0] = 0x50;
    answer.size = 1;
  }
}

void SimMoteus::write(const Subframe& subframe, SubframeWriter& answer) LITHE_RT {
  for (std::uint32_t i = 0; i < subframe.count; ++i) {
    const std::uint32_t number = subframe.start + i;
    const Access access = write_register(number, subframe.value(i));
    if (access != Access::done) answer.error(Kind::write_error, number, static_cast<std::uint32_t>(access));
  }
}

SimMoteus::Access SimMoteus::write_register(std::uint32_t number, double value) LITHE_RT {
  if (number == reg::kMode) return write_mode(value);
  if (double* target = field(command_, number)) {
    *target = value;
    return Access::done;
  }
  double unused = 0;
  return read_register(number, unused) ? Access::read_only : Access::unknown;
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

bool SimMoteus::read(const Subframe& subframe, SubframeWriter& answer) LITHE_RT {
  std::array<double, kMaxPayload> values{};
  if (subframe.count > values.size()) return false;  // no frame could hold it
  for (std::uint32_t i = 0; i < subframe.count; ++i) {
    const std::uint32_t number = subframe.start + i;
    if (read_register(number, values[i])) continue;
    answer.error(Kind::read_error, number, static_cast<std::uint32_t>(Access::unknown));
    return false;
  }
  answer.reply(subframe.format, subframe.start, {values.data(), subframe.count}, subframe.long_form);
  return answer.ok();
}

bool SimMoteus::read_register(std::uint32_t number, double& value) LITHE_RT {
  if (const double* source = field(command_, number)) {
    value = *source;
    return true;
  }
  if (read_status(number, value)) return true;
  switch (number) {
    case reg::kControlPosition:
      value = servo_.control_position_rev();
      return true;
    case reg::kControlVelocity:
      value = servo_.control_velocity_rev_s();
      return true;
    case reg::kControlTorque:
      value = servo_.control_torque_nm();
      return true;
    case reg::kMillisecondCounter:
      value = static_cast<double>(servo_.time_ns() / 1'000'000 % 32768);
      return true;
    case reg::kModel:
      value = 0;
      return true;
    case reg::kFirmware:
      value = 0x010000;
      return true;
    case reg::kRegisterMap:
      value = 5;
      return true;
    case reg::kId:
    case reg::kSerial:
    case reg::kSerial + 1:
    case reg::kSerial + 2:
      value = number == reg::kId ? id_ : number - reg::kSerial;
      return true;
    default:
      return false;
  }
}

bool SimMoteus::read_status(std::uint32_t number, double& value) LITHE_RT {
  constexpr double kHomedToOutput = 2;
  const ServoParams& params = servo_.params();
  switch (number) {
    case reg::kMode:
      value = static_cast<double>(servo_.mode());
      return true;
    case reg::kPosition:
    case reg::kAbsPosition:
      value = servo_.position_rev();
      return true;
    case reg::kVelocity:
      value = servo_.velocity_rev_s();
      return true;
    case reg::kTorque:
      value = servo_.torque_nm();
      return true;
    case reg::kQCurrent:
      value = servo_.torque_nm() / params.torque_constant_nm_a;
      return true;
    case reg::kDCurrent:
      value = 0;
      return true;
    case reg::kPower:
      value = servo_.torque_nm() * servo_.velocity_rev_s() * 2 * std::numbers::pi;
      return true;
    case reg::kMotorTemperature:
    case reg::kTemperature:
      value = params.temperature_c;
      return true;
    case reg::kTrajectoryComplete:
      value = servo_.trajectory_complete() ? 1 : 0;
      return true;
    case reg::kHomeState:
      value = kHomedToOutput;
      return true;
    case reg::kVoltage:
      value = params.supply_v;
      return true;
    case reg::kFault:
      value = servo_.fault();
      return true;
    default:
      return false;
  }
}

}  // namespace lithe::hal::sim
