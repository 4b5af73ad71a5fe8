// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/device/moteus_codec.hpp"

#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

namespace lithe::hal::moteus {
namespace {

constexpr std::uint8_t kWriteCode = 0x00, kReadCode = 0x10, kReplyCode = 0x20;
constexpr std::uint8_t kWriteErrorCode = 0x30, kReadErrorCode = 0x31;
constexpr std::uint32_t kMaxRegisters = 32;

// Rows: Kind; columns: int8, int16, int32.
constexpr double kLsb[11][3] = {
    {0.01, 0.0001, 0.00001},                          // position [rev]
    {0.1, 0.00025, 0.00001},                          // velocity [rev/s]
    {0.05, 0.001, 0.00001},                           // acceleration [rev/s^2]
    {0.5, 0.01, 0.001},                               // torque [N m]
    {1.0 / 127.0, 1.0 / 32767.0, 1.0 / 2147483647.0},  // pwm, gain scales
    {0.5, 0.1, 0.001},                                // voltage [V]
    {1.0, 0.1, 0.001},                                // temperature [degC]
    {1.0, 0.1, 0.001},                                // current [A]
    {0.01, 0.001, 0.000001},                          // time [s]
    {10.0, 0.05, 0.0001},                             // power [W]
    {1.0, 1.0, 1.0},                                  // integer
};

constexpr std::size_t bytes_of(Resolution resolution) LITHE_RT {
  constexpr std::size_t kBytes[] = {1, 2, 4, 4};
  return kBytes[static_cast<std::size_t>(resolution)];
}

constexpr std::int32_t largest(Resolution resolution) LITHE_RT {
  return resolution == Resolution::int8 ? 127 : resolution == Resolution::int16 ? 32767 : 2147483647;
}

constexpr std::size_t varuint_bytes(std::uint32_t value) LITHE_RT {
  std::size_t bytes = 1;
  while (value >>= 7) ++bytes;
  return bytes;
}

}  // namespace

Kind kind_of(std::uint32_t address) LITHE_RT {
  switch (address) {
    case 0x001: case 0x006: case 0x020: case 0x026: case 0x038: case 0x03b: case 0x040: case 0x041:
    case 0x050: case 0x052: case 0x054: case 0x130: case 0x131:
      return Kind::position;
    case 0x002: case 0x021: case 0x028: case 0x039: case 0x03c: case 0x051: case 0x053: case 0x055:
      return Kind::velocity;
    case 0x029:
      return Kind::acceleration;
    case 0x003: case 0x022: case 0x025: case 0x030: case 0x031: case 0x032: case 0x033: case 0x034: case 0x03a:
    case 0x03d: case 0x042: case 0x045:
      return Kind::torque;
    case 0x023: case 0x024: case 0x02b: case 0x043: case 0x044: case 0x047:
      return Kind::scale;
    case 0x004: case 0x005: case 0x01c: case 0x01d: case 0x02c:
      return Kind::current;
    case 0x007:
      return Kind::power;
    case 0x00a: case 0x00e:
      return Kind::temperature;
    case 0x00d: case 0x02a:
      return Kind::voltage;
    case 0x027: case 0x046:
      return Kind::time;
    default:
      return Kind::integer;
  }
}

double lsb(Kind kind, Resolution resolution) LITHE_RT {
  return resolution == Resolution::f32 ? 1.0 : kLsb[static_cast<std::size_t>(kind)][static_cast<std::size_t>(resolution)];
}

std::int32_t to_raw(double value, Kind kind, Resolution resolution) LITHE_RT {
  const std::int32_t top = largest(resolution);
  if (std::isnan(value)) return -top - 1;
  const double scaled = value / lsb(kind, resolution);
  if (scaled >= static_cast<double>(top)) return top;
  if (scaled <= -static_cast<double>(top)) return -top;
  return static_cast<std::int32_t>(scaled);
}

double from_raw(std::int32_t raw, Kind kind, Resolution resolution) LITHE_RT {
  if (raw == -largest(resolution) - 1) return std::numeric_limits<double>::quiet_NaN();
  return raw * lsb(kind, resolution);
}

std::size_t padded_size(std::size_t size) LITHE_RT {
  constexpr std::size_t kSteps[] = {12, 16, 20, 24, 32, 48, 64};
  if (size <= 8) return size;
  for (const std::size_t step : kSteps) {
    if (size <= step) return step;
  }
  return kMaxPayload;
}

bool Writer::room(std::size_t bytes) LITHE_RT {
  ok_ = ok_ && size_ + bytes <= kMaxPayload;
  return ok_;
}

void Writer::varuint(std::uint32_t value) LITHE_RT {
  while (value >= 0x80) {
    byte(static_cast<std::uint8_t>(value | 0x80));
    value >>= 7;
  }
  byte(static_cast<std::uint8_t>(value));
}

void Writer::value(double data, std::uint32_t address, Resolution resolution) LITHE_RT {
  const std::uint32_t bits = resolution == Resolution::f32
                                 ? std::bit_cast<std::uint32_t>(static_cast<float>(data))
                                 : static_cast<std::uint32_t>(to_raw(data, kind_of(address), resolution));
  for (std::size_t i = 0; i < bytes_of(resolution); ++i) byte(static_cast<std::uint8_t>(bits >> (8 * i)));
}

void Writer::values(std::uint8_t code, std::uint32_t start, Resolution resolution,
                    std::span<const double> data) LITHE_RT {
  const auto count = static_cast<std::uint32_t>(data.size());
  const std::size_t extra = count > 3 ? varuint_bytes(count) : 0;
  if (count == 0 || !room(1 + extra + varuint_bytes(start) + count * bytes_of(resolution))) return;
  byte(static_cast<std::uint8_t>(code | static_cast<std::uint32_t>(resolution) << 2 | (count > 3 ? 0 : count)));
  if (count > 3) varuint(count);
  varuint(start);
  for (std::uint32_t i = 0; i < count; ++i) value(data[i], start + i, resolution);
}

void Writer::write(std::uint32_t start, Resolution resolution, std::span<const double> data) LITHE_RT {
  values(kWriteCode, start, resolution, data);
}

void Writer::reply(std::uint32_t start, Resolution resolution, std::span<const double> data) LITHE_RT {
  values(kReplyCode, start, resolution, data);
}

void Writer::read(std::uint32_t start, Resolution resolution, std::uint32_t count) LITHE_RT {
  const std::size_t extra = count > 3 ? varuint_bytes(count) : 0;
  if (count == 0 || !room(1 + extra + varuint_bytes(start))) return;
  byte(static_cast<std::uint8_t>(kReadCode | static_cast<std::uint32_t>(resolution) << 2 | (count > 3 ? 0 : count)));
  if (count > 3) varuint(count);
  varuint(start);
}

void Writer::error(bool writing, std::uint32_t address, std::uint32_t code) LITHE_RT {
  if (!room(1 + varuint_bytes(address) + varuint_bytes(code))) return;
  byte(writing ? kWriteErrorCode : kReadErrorCode);
  varuint(address);
  varuint(code);
}

std::size_t Writer::finish() LITHE_RT {
  const std::size_t target = padded_size(size_);
  while (size_ < target) byte(kNop);
  return size_;
}

bool Reader::varuint(std::uint32_t& value) LITHE_RT {
  value = 0;
  for (unsigned shift = 0; shift < 35; shift += 7) {
    if (at_ >= payload_.size()) return fail();
    const std::uint8_t byte = payload_[at_++];
    value |= static_cast<std::uint32_t>(byte & 0x7f) << shift;
    if ((byte & 0x80) == 0) return true;
  }
  return fail();
}

bool Reader::value(std::uint32_t address, Resolution resolution, double& out) LITHE_RT {
  const std::size_t bytes = bytes_of(resolution);
  if (payload_.size() - at_ < bytes) return fail();
  std::uint32_t bits = 0;
  for (std::size_t i = 0; i < bytes; ++i) bits |= static_cast<std::uint32_t>(payload_[at_ + i]) << (8 * i);
  at_ += bytes;
  if (resolution == Resolution::f32) {
    out = static_cast<double>(std::bit_cast<float>(bits));
    return true;
  }
  const unsigned unused = static_cast<unsigned>(32 - 8 * bytes);
  const std::int32_t raw = static_cast<std::int32_t>(bits << unused) >> unused;  // sign extension
  out = from_raw(raw, kind_of(address), resolution);
  return true;
}

bool Reader::next(Subframe& subframe) LITHE_RT {
  while (at_ < payload_.size() && payload_[at_] == kNop) ++at_;
  if (at_ >= payload_.size()) return false;
  const std::uint8_t code = payload_[at_++];
  if (code == kWriteErrorCode || code == kReadErrorCode) {
    subframe.type = code == kWriteErrorCode ? Subframe::Type::write_error : Subframe::Type::read_error;
    return varuint(subframe.start) && varuint(subframe.count);
  }
  if (code >= 0x30) {
    subframe.type = Subframe::Type::unknown;
    at_ = payload_.size();  // its length is unknown too: the rest of the frame cannot be read
    return true;
  }
  subframe.type = code < kReadCode ? Subframe::Type::write : code < kReplyCode ? Subframe::Type::read
                                                                               : Subframe::Type::reply;
  subframe.resolution = static_cast<Resolution>((code >> 2) & 3);
  subframe.count = code & 3U;
  if (subframe.count == 0 && !varuint(subframe.count)) return false;
  if (!varuint(subframe.start)) return false;
  if (subframe.count == 0 || subframe.count > kMaxRegisters) return fail();
  if (subframe.type == Subframe::Type::read) return true;
  for (std::uint32_t i = 0; i < subframe.count; ++i) {
    if (!value(subframe.start + i, subframe.resolution, subframe.values[i])) return false;
  }
  return true;
}

const char* fault_name(std::uint32_t code) LITHE_RT {
  constexpr const char* kFaults[] = {
      "calibration", "motor driver", "over voltage", "encoder", "not configured", "pwm cycle overrun",
      "over temperature", "start outside limit", "under voltage", "configuration changed", "theta invalid",
      "position invalid", "driver enable", "stop position deprecated", "timing", "back-emf feed-forward without limit",
      "invalid limits", "position error", "velocity error"};
  constexpr const char* kLimits[] = {"velocity limit", "power limit", "voltage limit", "current limit",
                                     "drive temperature limit", "motor temperature limit", "torque limit",
                                     "position bounds", "flux braking", "field weakening"};
  if (code == 0) return "none";
  if (code >= 32 && code < 32 + std::size(kFaults)) return kFaults[code - 32];
  if (is_limit_code(code)) return kLimits[code - 96];
  return "unknown";
}

}  // namespace lithe::hal::moteus
