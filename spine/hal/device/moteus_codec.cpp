// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/device/moteus_codec.hpp"

#include <bit>
#include <cmath>
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
constexpr std::uint8_t kNop = 0x50;

// One count of int8, int16, int32, by Quantity.
constexpr double kWorth[][3] = {
    {1, 1, 1},                                   // integer
    {0.01, 0.0001, 0.00001},                     // position
    {0.1, 0.00025, 0.00001},                     // velocity
    {0.05, 0.001, 0.00001},                      // acceleration
    {0.5, 0.01, 0.001},                          // torque
    {1.0 / 127, 1.0 / 32767, 1.0 / 2147483647},  // fraction
    {0.5, 0.1, 0.001},                           // voltage
    {1, 0.1, 0.001},                             // temperature
    {1, 0.1, 0.001},                             // current
    {0.01, 0.001, 0.000001},                     // time
    {10, 0.05, 0.0001},                          // power
};

std::int32_t to_counts(double value, double worth, std::int32_t largest) LITHE_RT {
  if (std::isnan(value)) return -largest - 1;
  const double counts = value / worth;
  if (counts >= largest) return largest;
  if (counts <= -largest) return -largest;
  return static_cast<std::int32_t>(counts);
}

void put_little_endian(std::uint32_t bits, std::size_t bytes, std::uint8_t* out) LITHE_RT {
  for (std::size_t i = 0; i < bytes; ++i) out[i] = static_cast<std::uint8_t>(bits >> (8 * i));
}

std::uint32_t get_little_endian(const std::uint8_t* in, std::size_t bytes) LITHE_RT {
  std::uint32_t bits = 0;
  for (std::size_t i = 0; i < bytes; ++i) bits |= std::uint32_t{in[i]} << (8 * i);
  return bits;
}

std::size_t varuint_size(std::uint32_t value) LITHE_RT {
  std::size_t bytes = 1;
  while (value >= 0x80) {
    value >>= 7;
    ++bytes;
  }
  return bytes;
}

Quantity control_quantity(std::uint32_t number) LITHE_RT {  // 020 to 02d
  using enum Quantity;
  constexpr Quantity kTable[] = {position_rev, velocity_rev_s, torque_nm, fraction,       fraction,
                                 torque_nm,    position_rev,   time_s,    velocity_rev_s, acceleration_rev_s2,
                                 voltage_v,    fraction,       current_a, integer};
  return kTable[number - reg::kCommandPosition];
}

}  // namespace

Quantity quantity_of(std::uint32_t number) LITHE_RT {
  using enum Quantity;
  if (number >= reg::kCommandPosition && number <= reg::kIgnoreBounds) return control_quantity(number);
  switch (number) {
    case reg::kPosition:
    case reg::kAbsPosition:
    case reg::kControlPosition:
    case reg::kLowerBound:
    case reg::kUpperBound:
      return position_rev;
    case reg::kVelocity:
    case reg::kControlVelocity:
      return velocity_rev_s;
    case reg::kTorque:
    case reg::kControlTorque:
    case 0x042:
    case 0x045:
      return torque_nm;
    case reg::kQCurrent:
    case reg::kDCurrent:
    case reg::kCommandQCurrent:
    case reg::kCommandDCurrent:
      return current_a;
    case reg::kPower:
      return power_w;
    case reg::kVoltage:
      return voltage_v;
    case reg::kTemperature:
    case reg::kMotorTemperature:
      return temperature_c;
    case 0x043:
    case 0x044:
    case 0x047:
      return fraction;
    case 0x046:
      return time_s;
    default:
      return integer;
  }
}

double count_worth(Quantity quantity, Format format) LITHE_RT {
  if (format == Format::float32) return 1;
  return kWorth[static_cast<std::size_t>(quantity)][static_cast<std::size_t>(format)];
}

void encode_value(double value, Quantity quantity, Format format, std::uint8_t* out) LITHE_RT {
  const double worth = count_worth(quantity, format);
  std::uint32_t bits = 0;
  switch (format) {
    case Format::int8:
      bits = static_cast<std::uint32_t>(to_counts(value, worth, std::numeric_limits<std::int8_t>::max()));
      break;
    case Format::int16:
      bits = static_cast<std::uint32_t>(to_counts(value, worth, std::numeric_limits<std::int16_t>::max()));
      break;
    case Format::int32:
      bits = static_cast<std::uint32_t>(to_counts(value, worth, std::numeric_limits<std::int32_t>::max()));
      break;
    case Format::float32:
      bits = std::bit_cast<std::uint32_t>(static_cast<float>(value));
      break;
  }
  put_little_endian(bits, bytes_of(format), out);
}

double decode_value(const std::uint8_t* in, Quantity quantity, Format format) LITHE_RT {
  const std::uint32_t bits = get_little_endian(in, bytes_of(format));
  if (format == Format::float32) return std::bit_cast<float>(bits);
  const unsigned unused_bits = 32 - 8 * static_cast<unsigned>(bytes_of(format));
  const std::int32_t counts = static_cast<std::int32_t>(bits << unused_bits) >> unused_bits;
  const std::int32_t smallest = std::numeric_limits<std::int32_t>::min() >> unused_bits;
  if (counts == smallest) return std::numeric_limits<double>::quiet_NaN();
  return counts * count_worth(quantity, format);
}

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

void SubframeWriter::error(Kind kind, std::uint32_t number, std::uint32_t error) LITHE_RT {
  if (!fits(1 + varuint_size(number) + varuint_size(error))) return;
  byte(kind == Kind::read_error ? kReadError : kWriteError);
  varuint(number);
  varuint(error);
}

void SubframeWriter::empty_server_data(std::uint32_t channel) LITHE_RT {
  if (!fits(2 + varuint_size(channel))) return;
  byte(kServerData);
  varuint(channel);
  varuint(0);
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
  // A count beyond a frame can hold no values: refuse it before the multiplication can wrap.
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

}  // namespace lithe::hal::moteus
