// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/moteus/moteus_setup.hpp"

#include <fmt/format.h>

#include <bit>
#include <cmath>
#include <string_view>

#include "spine/hal/bus/serial/words.hpp"

namespace lithe::hal::moteus {
namespace {

constexpr std::uint32_t kChannel = 1;
constexpr double kKnownMap = 5;

// The first question reads a register, the others read settings through the console. The checks are in answered().
enum Question : std::uint8_t {
  kMap,
  kKp,
  kKd,
  kTimeoutMode,
  kTimeoutTorque,
  kRatio,
  kTimeout,
  kVelocityLimit,
  kAccelerationLimit,
  kIntegralLimit
};

constexpr std::array<std::string_view, 10> kLines{"",
                                                  "conf get servo.pid_position.kp\n",
                                                  "conf get servo.pid_position.kd\n",
                                                  "conf get servo.timeout_mode\n",
                                                  "conf get servo.timeout_max_torque_Nm\n",
                                                  "conf get motor_position.rotor_to_output_ratio\n",
                                                  "conf get servo.default_timeout_s\n",
                                                  "conf get servo.default_velocity_limit\n",
                                                  "conf get servo.default_accel_limit\n",
                                                  "conf get servo.pid_position.ilimit\n"};

// Commands are divided by it, and the result must fit a float.
bool can_scale(double gain) LITHE_RT { return gain >= 1e-9 && gain <= 1e9; }

// The name of the setting behind a question.
std::string_view name_of(std::uint8_t question) {
  constexpr std::string_view kGet = "conf get ";
  const std::string_view line = kLines[question % kLines.size()];
  return line.size() <= kGet.size() ? "register 102h" : line.substr(kGet.size(), line.size() - kGet.size() - 1);
}

}  // namespace

void Setup::ask(SubframeWriter& writer) LITHE_RT {
  ++exchanges_;
  if (ready()) return;
  if (phase_ == Phase::rest) {
    if (exchanges_ < kRest) return;
    const Setup before = *this;
    restart();
    not_ready_ = before.not_ready_;  // until there is a new answer
    unanswered_question_ = before.unanswered_question_;
    value_ = before.value_;
  }
  if (question_ == kMap) {
    writer.read(Format::int32, reg::kRegisterMap, 1);
  } else if (phase_ == Phase::say) {
    const std::string_view line =
        setting_ ? std::string_view(expected_.damp_line.data(), expected_.damp_line_length) : kLines[question_];
    writer.client_data(kChannel, {reinterpret_cast<const std::uint8_t*>(line.data()), line.size()});
  } else {
    writer.poll(kChannel, kMostBytes);
  }
}

void Setup::missed() LITHE_RT {
  if (ready() || phase_ == Phase::rest) return;
  phase_ = Phase::empty;  // the answer so far is incomplete
  exchanges_ = 0;
  length_ = 0;
  too_long_ = false;
}

void Setup::on_frame(const Frame& answer) LITHE_RT {
  if (ready() || phase_ == Phase::rest) return;
  const Phase asked = phase_;
  const std::size_t question = question_;
  bool heard = false;
  SubframeReader reader(answer.payload());
  Subframe s;
  while (question_ == question && phase_ != Phase::rest && reader.next(s)) {
    if (question_ == kMap && s.kind == Kind::reply) on_register_map(s);
    if (s.kind != Kind::server_data || s.start != kChannel) continue;
    heard = heard || s.count > 0;
    if (asked != Phase::empty) on_text(s);
  }
  if (phase_ != asked || question_ != question) return;
  if (asked == Phase::say) {
    phase_ = Phase::listen;
    exchanges_ = 0;
  } else if (asked == Phase::empty && !heard && question_ != kMap) {
    phase_ = Phase::say;
  } else if (exchanges_ > kPatience) {
    refuse(NotReady::unsaid, 0);
  }
}

void Setup::on_register_map(const Subframe& reply) LITHE_RT {
  if (reply.start != reg::kRegisterMap || reply.format != Format::int32 || reply.count != 1) return;
  answered(reply.value(0));
}

// Lines end with either or both of these; empty lines are ignored.
void Setup::on_text(const Subframe& data) LITHE_RT {
  for (std::uint32_t i = 0; i < data.count; ++i) {
    const char c = static_cast<char>(data.data[i]);
    if (c == '\r' || c == '\n') {
      if (length_ > 0) on_line();
      length_ = 0;
      too_long_ = false;
      if (phase_ == Phase::rest || phase_ == Phase::empty) return;  // answer complete; the rest is for others
    } else if (length_ < line_.size()) {
      line_[length_++] = c;
    } else {
      too_long_ = true;
    }
  }
}

void Setup::on_line() LITHE_RT {
  const std::string_view line(line_.data(), length_);
  if (setting_) {  // the reply is ignored: the next read shows the value
    setting_ = false;
    phase_ = Phase::empty;
    exchanges_ = 0;
    return;
  }
  double value = 0;
  if (!too_long_ && read_number(line, value)) return answered(value);
  // "No such setting", or output for another client. The ratio setting is newer than the others: without it no ratio is
  // assumed.
  if (question_ == kRatio && begins(line, "ERR")) return answered(std::numeric_limits<double>::quiet_NaN());
  refuse(NotReady::unsaid, 0);
}

void Setup::answered(double value) LITHE_RT {
  switch (question_) {
    case kMap:
      return value == kKnownMap ? next() : refuse(NotReady::register_map, value);
    case kKp:
      return answered_gain(value, expected_.least_kp_nm_rev, settings_.kp_nm_rev);
    case kKd:
      return answered_gain(value, expected_.least_kd_nm_s_rev, settings_.kd_nm_s_rev);
    case kTimeoutMode: {
      if (value == static_cast<double>(Mode::position))
        return expected_.may_hold ? next() : refuse(NotReady::holds, value);
      const bool stops = value == static_cast<double>(Mode::zero_velocity) || value == static_cast<double>(Mode::brake);
      return stops ? next() : refuse(NotReady::limp, value);
    }
    case kTimeoutTorque:
      return value > 0 ? limit_damping(value) : refuse(NotReady::limp, value);
    case kTimeout: {
      constexpr double kAlike = 1e-3;  // s; the console has six digits
      return std::abs(value - expected_.watchdog_s) <= kAlike ? next() : refuse(NotReady::setting, value);
    }
    case kVelocityLimit:
    case kAccelerationLimit:
      return std::isnan(value) ? next() : refuse(NotReady::setting, value);
    case kIntegralLimit:
      return value == 0 ? next() : refuse(NotReady::setting, value);
    default:
      settings_.rotor_to_output_ratio = value;
      next();
  }
}

void Setup::answered_gain(double value, double least, double& gain) LITHE_RT {
  gain = value;
  if (!can_scale(value)) return refuse(NotReady::gain, value);
  value < least ? refuse(NotReady::weak, value) : next();
}

void Setup::limit_damping(double value) LITHE_RT {
  constexpr double kRounding = 1.001;
  if (value <= expected_.damp_torque_max_nm * kRounding) return next();
  if (was_set_) return refuse(NotReady::too_strong, value);
  setting_ = was_set_ = true;
  phase_ = Phase::empty;
  exchanges_ = 0;
}

void Setup::next() LITHE_RT {
  ++question_;
  phase_ = Phase::empty;
  exchanges_ = 0;
  if (ready()) not_ready_ = NotReady::none;
}

void Setup::refuse(NotReady not_ready, double value) LITHE_RT {
  not_ready_ = not_ready;
  unanswered_question_ = static_cast<std::uint8_t>(question_);
  value_ = static_cast<float>(value);
  phase_ = Phase::rest;
  exchanges_ = 0;
}

std::uint64_t Setup::packed() const LITHE_RT {
  return std::uint64_t{static_cast<std::uint8_t>(not_ready_)} << 40 | std::uint64_t{unanswered_question_} << 32 |
         std::bit_cast<std::uint32_t>(value_);
}

std::string describe_not_ready(std::uint64_t packed) {
  constexpr const char* kAdvice[] = {
      "",
      "has not yet said how it is set; check its power, cable and id",
      ", LITHE knows 5: update the drive's firmware",
      "' with a number; end other programs that use its console",
      ", and a command can only scale it: set it above 0, as its motor needs it (conf set, conf write)",
      ": the joint would fall when this computer dies; set servo.timeout_mode to 12 and servo.timeout_max_torque_Nm "
      "above 0 (conf set, conf write)",
      ": when this computer dies, the drive would go on and hold the joint with its own gains, without a limit; set it "
      "to damp (conf set servo.timeout_mode 12, then conf write), or permit it: may_hold_alone = true in its "
      "[[device]]",
      ", less than the joint's kp_max_nm_rad, kd_max_nm_s_rad or safe_kd_nm_s_rad, and [device.frames] command in "
      "whole "
      "numbers can ask for no more than the drive's own gain: raise the gain (conf set, conf write), lower those, or "
      "say command = \"float\"",
      ", and [device.frames] settings = \"drive\" leaves it to the drive: set servo.default_timeout_s to the device's "
      "watchdog_s, servo.default_velocity_limit and servo.default_accel_limit to nan, servo.pid_position.ilimit to 0 "
      "(conf set, conf write), or say settings = \"command\"",
      ": left alone it would damp with more than the joint's torque_max_nm, and it does not take less from here; set "
      "it "
      "lower (conf set, conf write)"};
  const auto why = static_cast<NotReady>(packed >> 40);
  const std::string name(name_of(static_cast<std::uint8_t>(packed >> 32))), advice = kAdvice[packed >> 40];
  if (why == NotReady::unsaid) return "does not answer 'conf get " + name + advice;
  if (why <= NotReady::silent) return advice;
  return fmt::format("{} is {:g}{}", name, std::bit_cast<float>(static_cast<std::uint32_t>(packed)), advice);
}

}  // namespace lithe::hal::moteus
