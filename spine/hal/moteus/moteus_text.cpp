// SPDX-License-Identifier: Apache-2.0
// Text for the frames of moteus drives and of who talks to them.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "spine/core/text.hpp"
#include "spine/hal/moteus/moteus_faults.hpp"
#include "spine/hal/moteus/moteus_scanner.hpp"

namespace lithe::hal::moteus {
namespace {

constexpr std::pair<std::uint32_t, const char*> kNames[] = {
    {reg::kMode, "mode"},
    {reg::kPosition, "position"},
    {reg::kVelocity, "velocity"},
    {reg::kTorque, "torque"},
    {reg::kQCurrent, "q current"},
    {reg::kDCurrent, "d current"},
    {reg::kAbsPosition, "absolute position"},
    {reg::kPower, "power"},
    {reg::kMotorTemperature, "motor temperature"},
    {reg::kTrajectoryComplete, "trajectory complete"},
    {reg::kHomeState, "home state"},
    {reg::kVoltage, "voltage"},
    {reg::kTemperature, "temperature"},
    {reg::kFault, "fault"},
    {reg::kCommandQCurrent, "q current"},
    {reg::kCommandDCurrent, "d current"},
    {reg::kCommandPosition, "position"},
    {reg::kCommandVelocity, "velocity"},
    {reg::kCommandTorque, "torque"},
    {reg::kKpScale, "kp scale"},
    {reg::kKdScale, "kd scale"},
    {reg::kMaxTorque, "most torque"},
    {reg::kStopPosition, "stop position"},
    {reg::kWatchdog, "watchdog"},
    {reg::kVelocityLimit, "velocity limit"},
    {reg::kAccelerationLimit, "acceleration limit"},
    {reg::kFixedVoltage, "fixed voltage"},
    {reg::kIntegralScale, "integral scale"},
    {reg::kFixedCurrent, "fixed current"},
    {reg::kIgnoreBounds, "ignore bounds"},
    {reg::kControlPosition, "control position"},
    {reg::kControlVelocity, "control velocity"},
    {reg::kControlTorque, "control torque"},
    {reg::kErrorPosition, "position error"},
    {reg::kErrorVelocity, "velocity error"},
    {reg::kErrorTorque, "torque error"},
    {reg::kLowerBound, "lower bound"},
    {reg::kUpperBound, "upper bound"},
    {reg::kEncoderValidity, "encoder validity"},
    {reg::kMillisecondCounter, "milliseconds"},
    {reg::kClockTrim, "clock trim"},
    {reg::kModel, "model"},
    {reg::kFirmware, "firmware"},
    {reg::kRegisterMap, "register map"},
    {reg::kId, "id"},
    {reg::kSetOutputNearest, "set output, nearest"},
    {reg::kSetOutputExact, "set output, exact"},
    {reg::kRequireReindex, "require reindex"},
    {reg::kRecapture, "recapture"},
    {reg::kUuidMaskCapable, "uuid mask capable"},
};

std::string name_of(std::uint32_t number) {
  const auto* const found =
      std::find_if(std::begin(kNames), std::end(kNames), [number](const auto& each) { return each.first == number; });
  if (found != std::end(kNames)) return found->second;
  if (number >= reg::kSerial && number < reg::kSerial + 3) return fmt::format("serial {}", number - reg::kSerial);
  if (number >= reg::kUuid && number < reg::kUuid + 4) return fmt::format("uuid {}", number - reg::kUuid);
  if (number >= reg::kUuidMask && number < reg::kUuidMask + 4)
    return fmt::format("uuid mask {}", number - reg::kUuidMask);
  return fmt::format("register {:03x}h", number);
}

const char* unit_of(Quantity quantity) {
  constexpr std::array kUnits{"", " rev", " rev/s", " rev/s2", " Nm", "", " V", " C", " A", " s", " W"};
  return kUnits[static_cast<std::size_t>(quantity)];
}

std::string value_text(std::uint32_t number, double value) {
  if (std::isnan(value)) return "none";
  if (number == reg::kMode) return mode_name(static_cast<Mode>(std::clamp(value, 0.0, 255.0)));
  if (number == reg::kFault) return fault_name(static_cast<std::uint32_t>(std::clamp(value, 0.0, 255.0)));
  const Quantity quantity = quantity_of(number);
  if (quantity == Quantity::integer && value == std::trunc(value)) return fmt::format("{:.0f}", value);
  return fmt::format("{:.5g}{}", value, unit_of(quantity));
}

// Serial numbers and UUIDs: patterns, of which none means "no number".
bool is_pattern(std::uint32_t number) {
  const auto within = [number](std::uint32_t first, std::uint32_t count) { return number - first < count; };
  return within(reg::kSerial, 3) || within(reg::kUuid, 4) || within(reg::kUuidMask, 4);
}

std::string value_text(const Subframe& s, std::uint32_t i) {
  const std::uint32_t number = s.start + i;
  if (!is_pattern(number) || s.format != Format::int32) return value_text(number, s.value(i));
  return fmt::format("{:08x}", little_endian(s.data + std::size_t{4} * i, 4));
}

// A read may name more registers than a frame can answer: show only the first and the last.
std::string read_text(const Subframe& s) {
  if (s.count == 1) return "read " + name_of(s.start);
  return fmt::format("read {} to {}", name_of(s.start), name_of(s.start + s.count - 1));
}

std::string values_text(const Subframe& s) {
  std::string text;
  for (std::uint32_t i = 0; i < s.count; ++i) {
    text += fmt::format("{}{} {}", i == 0 ? "" : ", ", name_of(s.start + i), value_text(s, i));
  }
  return text;
}

std::string stream_text(const Subframe& s) {
  const std::string_view bytes(reinterpret_cast<const char*>(s.data), s.count);
  return fmt::format("channel {} '{}'", s.start, printable(bytes));
}

// The text, and whether a host sends this kind of frame.
std::pair<std::string, bool> subframe_text(const Subframe& s) {
  switch (s.kind) {
    case Kind::write:
      return {"write " + values_text(s), true};
    case Kind::read:
      return {read_text(s), true};
    case Kind::reply:
      return {values_text(s), false};
    case Kind::write_error:
      return {fmt::format("cannot write {}: error {}", name_of(s.start), s.error), false};
    case Kind::read_error:
      return {fmt::format("cannot read {}: error {}", name_of(s.start), s.error), false};
    case Kind::client_data:
      return {"to " + stream_text(s), true};
    case Kind::server_data:
      return {"from " + stream_text(s), false};
    case Kind::poll:
      return {fmt::format("poll channel {}", s.start), true};
    case Kind::flow:
      break;
  }
  return {"stream with flow control", false};  // used in both directions: the reply bit decides
}

}  // namespace

FrameText frame_text(const Frame& frame, const FrameContext& /*context*/) {
  constexpr std::uint32_t kReplyRequested = 0x8000, kBroadcast = 0x7f;
  FrameText decoded;
  decoded.outbound = (frame.id & kReplyRequested) != 0;
  SubframeReader reader(frame.payload());
  Subframe s;
  while (reader.next(s)) {
    const auto [text, outbound] = subframe_text(s);
    decoded.outbound = decoded.outbound || outbound;
    decoded.text += (decoded.text.empty() ? "" : "; ") + text;
  }
  if (!reader.well_formed()) decoded.text += decoded.text.empty() ? "malformed" : "; malformed";
  if (decoded.text.empty()) decoded.text = "nothing";
  const std::uint32_t device = decoded.outbound ? frame.id & 0x7f : frame.id >> 8 & 0x7f;
  if (!decoded.outbound || device != kBroadcast) decoded.device = device;
  return decoded;
}

}  // namespace lithe::hal::moteus
