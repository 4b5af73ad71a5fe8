// SPDX-License-Identifier: Apache-2.0
// Text for the frames of moteus drives and of who talks to them.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <initializer_list>
#include <utility>

#include "spine/core/text.hpp"
#include "spine/hal/moteus/moteus.hpp"
#include "spine/hal/moteus/moteus_codec.hpp"

namespace lithe::hal::moteus {
namespace {

// Names of registers with numbers in a row.
struct Names {
  std::uint32_t first;
  std::initializer_list<const char*> names;
};

std::string name_of(std::uint32_t number) {
  static const Names all_names[] = {
      {reg::kMode, {"mode", "position", "velocity", "torque", "q current", "d current", "absolute position", "power"}},
      {reg::kMotorTemperature,
       {"motor temperature", "trajectory complete", "home state", "voltage", "temperature", "fault"}},
      {reg::kCommandQCurrent, {"q current", "d current"}},
      {reg::kCommandPosition,
       {"position", "velocity", "torque", "kp scale", "kd scale", "most torque", "stop position", "watchdog",
        "velocity limit", "acceleration limit", "fixed voltage", "integral scale", "fixed current", "ignore bounds"}},
      {reg::kControlPosition,
       {"control position", "control velocity", "control torque", "position error", "velocity error", "torque error"}},
      {reg::kLowerBound, {"lower bound", "upper bound"}},
      {reg::kEncoderValidity, {"encoder validity"}},
      {reg::kMillisecondCounter, {"milliseconds", "clock trim"}},
      {reg::kModel, {"model", "firmware", "register map"}},
      {reg::kId, {"id"}},
      {reg::kSerial, {"serial 0", "serial 1", "serial 2"}},
      {reg::kSetOutputNearest, {"set output, nearest", "set output, exact", "require reindex", "recapture"}},
      {reg::kUuid, {"uuid 0", "uuid 1", "uuid 2", "uuid 3"}},
      {reg::kUuidMask, {"uuid mask 0", "uuid mask 1", "uuid mask 2", "uuid mask 3"}},
      {reg::kUuidMaskCapable, {"uuid mask capable"}},
  };
  for (const Names& row : all_names)
    if (number - row.first < row.names.size()) return row.names.begin()[number - row.first];
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
  for (std::uint32_t i = 0; i < s.count; ++i)
    text += fmt::format("{}{} {}", i == 0 ? "" : ", ", name_of(s.start + i), value_text(s, i));
  return text;
}

std::string stream_text(const Subframe& s) {
  const std::string_view bytes(reinterpret_cast<const char*>(s.data), s.count);
  return fmt::format("channel {} '{}'", s.start, printable(bytes));
}

// The text, and whether a host sends this kind of frame.
std::pair<std::string, bool> subframe_text(const Subframe& s) {
  if (s.kind == Kind::write) return {"write " + values_text(s), true};
  if (s.kind == Kind::read) return {read_text(s), true};
  if (s.kind == Kind::reply) return {values_text(s), false};
  if (s.kind == Kind::write_error) return {fmt::format("cannot write {}: error {}", name_of(s.start), s.error), false};
  if (s.kind == Kind::read_error) return {fmt::format("cannot read {}: error {}", name_of(s.start), s.error), false};
  if (s.kind == Kind::client_data) return {"to " + stream_text(s), true};
  if (s.kind == Kind::server_data) return {"from " + stream_text(s), false};
  if (s.kind == Kind::poll) return {fmt::format("poll channel {}", s.start), true};
  return {"stream with flow control", false};  // used in both directions: the reply bit decides
}

}  // namespace

FrameText frame_text(const Frame& frame, const FrameContext& /*context*/) {
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
