// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/moteus/moteus_codec.hpp"

#include <array>
#include <bit>
#include <cmath>
#include <initializer_list>
#include <limits>

namespace lithe::hal::moteus {
namespace {

constexpr std::uint8_t kWrite = 0x00;
constexpr std::uint8_t kRead = 0x10;
constexpr std::uint8_t kReply = 0x20;
constexpr std::uint8_t kWriteError = 0x30;
constexpr std::uint8_t kReadError = 0x31;
constexpr std::uint8_t kClientData = 0x40;
constexpr std::uint8_t kServerData = 0x41;
constexpr std::uint8_t kPoll = 0x42;
constexpr std::uint8_t kServerFlow = 0x43;
constexpr std::uint8_t kPollFlow = 0x44;
constexpr std::uint8_t kNop = 0x50;

std::size_t varuint_size(std::uint32_t value) LITHE_RT {
  std::size_t bytes = 1;
  while (value >= 0x80) {
    value >>= 7;
    ++bytes;
  }
  return bytes;
}

}  // namespace

void SubframeWriter::write(Format format, std::uint32_t start, std::span<const double> list) LITHE_RT {
  values(kWrite, format, start, list, false);
}

void SubframeWriter::reply(Format format, std::uint32_t start, std::span<const double> list, bool long_form) LITHE_RT {
  values(kReply, format, start, list, long_form);
}

void SubframeWriter::values(std::uint8_t base, Format format, std::uint32_t start, std::span<const double> list,
                            bool long_form) LITHE_RT {
  const std::size_t width = bytes_of(format);
  const auto count = static_cast<std::uint32_t>(list.size());
  const bool in_head = count >= 1 && count <= 3 && !long_form;
  if (list.size() > kMaxPayload) {
    ok_ = false;
    return;
  }
  if (!fits(1 + (in_head ? 0 : varuint_size(count)) + varuint_size(start) + count * width)) return;
  byte(static_cast<std::uint8_t>(base | static_cast<unsigned>(format) << 2 | (in_head ? count : 0)));
  if (!in_head) varuint(count);
  varuint(start);
  for (std::uint32_t i = 0; i < count; ++i) {
    encode_value(list[i], quantity_of(start + i), format, frame_->data.data() + frame_->size);
    frame_->size = static_cast<std::uint8_t>(frame_->size + width);
  }
}

void SubframeWriter::read(Format format, std::uint32_t start, std::uint32_t count) LITHE_RT {
  const bool in_head = count >= 1 && count <= 3;
  if (!fits(1 + (in_head ? 0 : varuint_size(count)) + varuint_size(start))) return;
  byte(static_cast<std::uint8_t>(kRead | static_cast<unsigned>(format) << 2 | (in_head ? count : 0)));
  if (!in_head) varuint(count);
  varuint(start);
}

namespace {

// Length of the run with the first one's format.
std::size_t run_of(std::span<const SubframeWriter::Choice> formats) LITHE_RT {
  std::size_t count = 1;
  while (count < formats.size() && formats[count] == formats[0]) ++count;
  return count;
}

}  // namespace

void SubframeWriter::write_each(std::uint32_t start, std::span<const Choice> formats, std::span<const double> values)
    LITHE_RT {
  for (std::size_t at = 0; at < formats.size();) {
    const std::size_t count = run_of(formats.subspan(at));
    if (formats[at]) write(*formats[at], start + static_cast<std::uint32_t>(at), values.subspan(at, count));
    at += count;
  }
}

void SubframeWriter::read_each(std::uint32_t start, std::span<const Choice> formats) LITHE_RT {
  for (std::size_t at = 0; at < formats.size();) {
    const std::size_t count = run_of(formats.subspan(at));
    if (formats[at]) read(*formats[at], start + static_cast<std::uint32_t>(at), static_cast<std::uint32_t>(count));
    at += count;
  }
}

void SubframeWriter::numbers(std::uint8_t head, std::uint32_t first, std::uint32_t second) LITHE_RT {
  if (!fits(1 + varuint_size(first) + varuint_size(second))) return;
  byte(head);
  varuint(first);
  varuint(second);
}

void SubframeWriter::error(Kind kind, std::uint32_t number, std::uint32_t error) LITHE_RT {
  numbers(kind == Kind::read_error ? kReadError : kWriteError, number, error);
}

void SubframeWriter::poll(std::uint32_t channel, std::uint32_t most) LITHE_RT { numbers(kPoll, channel, most); }

void SubframeWriter::server_data(std::uint32_t channel, std::span<const std::uint8_t> bytes) LITHE_RT {
  stream(kServerData, channel, bytes);
}

void SubframeWriter::client_data(std::uint32_t channel, std::span<const std::uint8_t> bytes) LITHE_RT {
  stream(kClientData, channel, bytes);
}

void SubframeWriter::stream(std::uint8_t head, std::uint32_t channel, std::span<const std::uint8_t> bytes) LITHE_RT {
  const auto count = static_cast<std::uint32_t>(bytes.size());
  if (bytes.size() > kMaxPayload) {
    ok_ = false;
    return;
  }
  if (!fits(1 + varuint_size(channel) + varuint_size(count) + bytes.size())) return;
  byte(head);
  varuint(channel);
  varuint(count);
  for (const std::uint8_t each : bytes) byte(each);
}

void SubframeWriter::pad() LITHE_RT {
  const std::size_t size = fd_size(frame_->size);
  while (frame_->size < size) byte(kNop);
}

bool SubframeWriter::fits(std::size_t bytes) LITHE_RT {
  if (frame_->size + bytes <= kMaxPayload) return true;
  ok_ = false;
  return false;
}

void SubframeWriter::varuint(std::uint32_t value) LITHE_RT {
  while (value >= 0x80) {
    byte(static_cast<std::uint8_t>(value | 0x80));
    value >>= 7;
  }
  byte(static_cast<std::uint8_t>(value));
}

bool SubframeReader::next(Subframe& out) LITHE_RT {
  while (!rest_.empty() && rest_[0] == kNop) rest_ = rest_.subspan(1);
  if (rest_.empty()) return false;
  const std::uint8_t head = rest_[0];
  rest_ = rest_.subspan(1);
  out = Subframe{};
  if (parse(head, out)) return true;
  well_formed_ = false;
  rest_ = {};
  return false;
}

bool SubframeReader::parse(std::uint8_t head, Subframe& out) LITHE_RT {
  if (head < kWriteError) return registers(head, out);
  switch (head) {
    case kWriteError:
    case kReadError:
      out.kind = head == kReadError ? Kind::read_error : Kind::write_error;
      return varuint(out.start) && varuint(out.error);
    case kClientData:
    case kServerData:
      out.kind = head == kClientData ? Kind::client_data : Kind::server_data;
      return varuint(out.start) && varuint(out.count) && take(out.count, out);
    case kPoll:
      out.kind = Kind::poll;
      return varuint(out.start) && varuint(out.count);
    case kServerFlow:
    case kPollFlow:
      out.kind = Kind::flow;
      rest_ = {};  // its length is unknown, so parsing stops here
      return true;
    default:
      return false;
  }
}

bool SubframeReader::registers(std::uint8_t head, Subframe& out) LITHE_RT {
  out.kind = head < kRead ? Kind::write : head < kReply ? Kind::read : Kind::reply;
  out.format = static_cast<Format>((head >> 2) & 3);
  out.count = head & 3;
  out.long_form = out.count == 0;
  if (out.long_form && !varuint(out.count)) return false;
  if (!varuint(out.start)) return false;
  // A count larger than a frame is refused before the multiplication can overflow.
  return out.kind == Kind::read || (out.count <= kMaxPayload && take(out.count * bytes_of(out.format), out));
}

bool SubframeReader::varuint(std::uint32_t& value) LITHE_RT {
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < 5 && i < rest_.size(); ++i) {
    sum |= std::uint64_t{rest_[i] & 0x7fU} << (7 * i);
    if (rest_[i] & 0x80) continue;
    rest_ = rest_.subspan(i + 1);
    value = static_cast<std::uint32_t>(sum);
    return sum <= std::numeric_limits<std::uint32_t>::max();
  }
  return false;
}

bool SubframeReader::take(std::size_t bytes, Subframe& out) LITHE_RT {
  if (bytes > rest_.size()) return false;
  out.data = rest_.data();
  rest_ = rest_.subspan(bytes);
  return true;
}

// Units and encoding of register values.
namespace {

std::int32_t to_counts(double value, double worth, std::int32_t most) LITHE_RT {
  if (!std::isfinite(value)) return -most - 1;
  const double counts = value / worth;
  if (counts >= most) return most;
  if (counts <= -most) return -most;
  return static_cast<std::int32_t>(counts);
}

constexpr std::size_t kLow = 0x080;  // from here on only integers, with two exceptions

constexpr std::array<Quantity, kLow> table() {
  using enum Quantity;
  std::array<Quantity, kLow> of{};  // integer by default
  const auto row = [&of](std::uint32_t first, std::initializer_list<Quantity> quantities) {
    for (const Quantity quantity : quantities) of[first++] = quantity;
  };
  row(reg::kPosition, {position_rev, velocity_rev_s, torque_nm, current_a, current_a, position_rev, power_w});
  row(reg::kMotorTemperature, {temperature_c});
  row(reg::kVoltage, {voltage_v, temperature_c});
  row(reg::kCommandQCurrent, {current_a, current_a});
  row(reg::kCommandPosition, {position_rev, velocity_rev_s, torque_nm, fraction, fraction, torque_nm, position_rev,
                              time_s, velocity_rev_s, acceleration_rev_s2, voltage_v, fraction, current_a});
  row(reg::kTermP, {torque_nm, torque_nm, torque_nm, torque_nm, torque_nm});
  row(reg::kControlPosition, {position_rev, velocity_rev_s, torque_nm, position_rev, velocity_rev_s, torque_nm});
  row(reg::kLowerBound, {position_rev, position_rev, torque_nm, fraction, fraction, torque_nm, time_s, fraction});
  row(reg::kEncoder, {position_rev, velocity_rev_s, position_rev, velocity_rev_s, position_rev, velocity_rev_s});
  for (const std::uint32_t port : {reg::kAux1Analog, reg::kAux2Analog, reg::kAuxPwm, reg::kAuxPwm + 5})
    row(port, {fraction, fraction, fraction, fraction, fraction});
  of[reg::kPwmInput + 1] = of[reg::kPwmInput + 3] = fraction;
  return of;
}

constexpr std::array<Quantity, kLow> kTable = table();

}  // namespace

Quantity quantity_of(std::uint32_t number) LITHE_RT {
  if (number < kLow) return kTable[number];
  const bool output = number == reg::kSetOutputNearest || number == reg::kSetOutputExact;
  return output ? Quantity::position_rev : Quantity::integer;
}

void encode_value(double value, Quantity quantity, Format format, std::uint8_t* out) LITHE_RT {
  const double worth = count_worth(quantity, format);
  constexpr std::array<std::int32_t, 3> kMost{127, 32767, std::numeric_limits<std::int32_t>::max()};  // by Format
  const std::uint32_t bits =
      format == Format::float32
          ? std::bit_cast<std::uint32_t>(static_cast<float>(value))
          : static_cast<std::uint32_t>(to_counts(value, worth, kMost[static_cast<std::size_t>(format)]));
  put_little_endian(out, bits, bytes_of(format));
}

double decode_value(const std::uint8_t* in, Quantity quantity, Format format) LITHE_RT {
  const std::uint32_t bits = little_endian(in, bytes_of(format));
  if (format == Format::float32) return std::bit_cast<float>(bits);
  const unsigned unused_bits = 32 - 8 * static_cast<unsigned>(bytes_of(format));
  const std::int32_t counts = static_cast<std::int32_t>(bits << unused_bits) >> unused_bits;
  const std::int32_t smallest = std::numeric_limits<std::int32_t>::min() >> unused_bits;
  if (counts == smallest) return std::numeric_limits<double>::quiet_NaN();
  return counts * count_worth(quantity, format);
}

// Names of faults and modes.
namespace {

constexpr std::uint32_t kFirstFault = fault::kCalibration;
constexpr std::array kFaults{"calibration failed",
                             "gate driver fault",
                             "over-voltage",
                             "encoder fault",
                             "motor not configured",
                             "control loop overran its PWM cycle",
                             "over-temperature",
                             "started outside its position bounds",
                             "under-voltage",
                             "configuration changed while driving",
                             "no valid commutation angle",
                             "no valid position",
                             "gate driver could not be enabled",
                             "stop position together with velocity or acceleration limit",
                             "control timing violated",
                             "back-EMF feedforward without acceleration limit",
                             "invalid limits",
                             "position error too large",
                             "velocity error too large"};

constexpr std::uint32_t kFirstLimit = fault::kLimitVelocity;
constexpr std::array kLimits{
    "velocity limit",          "power limit",  "voltage limit",   "current limit", "temperature limit",
    "motor temperature limit", "torque limit", "position bounds", "flux braking",  "field weakening"};

constexpr std::array kModes{"stopped",  "fault",   "enabling",      "calibrating", "calibration complete",
                            "pwm",      "voltage", "voltage foc",   "voltage dq",  "current",
                            "position", "timeout", "zero velocity", "stay within", "measure inductance",
                            "brake"};

}  // namespace

const char* fault_name(std::uint32_t code) LITHE_RT {
  if (code == 0) return "none";
  if (code >= kFirstFault && code - kFirstFault < kFaults.size()) return kFaults[code - kFirstFault];
  if (code >= kFirstLimit && code - kFirstLimit < kLimits.size()) return kLimits[code - kFirstLimit];
  return "unknown";
}

const char* mode_name(Mode mode) LITHE_RT {
  const auto index = static_cast<std::size_t>(mode);
  return index < kModes.size() ? kModes[index] : "unknown";
}

}  // namespace lithe::hal::moteus
