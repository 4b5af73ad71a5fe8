// SPDX-License-Identifier: Apache-2.0
// What the numbers in the registers mean, and how they are written.
#include <bit>
#include <cmath>
#include <limits>

#include "spine/hal/device/moteus_codec.hpp"

namespace lithe::hal::moteus {
namespace {

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

std::int32_t to_counts(double value, double worth, std::int32_t most) LITHE_RT {
  if (!std::isfinite(value)) return -most - 1;
  const double counts = value / worth;
  if (counts >= most) return most;
  if (counts <= -most) return -most;
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
  if (number >= reg::kTermP && number < reg::kTermP + 5) return torque_nm;
  if (number >= reg::kEncoder && number < reg::kEncoder + 6) {
    return (number - reg::kEncoder) % 2 == 0 ? position_rev : velocity_rev_s;
  }
  const bool analog = (number >= reg::kAux1Analog && number < reg::kAux1Analog + 5) ||
                      (number >= reg::kAux2Analog && number < reg::kAux2Analog + 5);
  if (analog || (number >= reg::kAuxPwm && number < reg::kAuxPwm + 10)) return fraction;
  switch (number) {
    case reg::kPosition:
    case reg::kAbsPosition:
    case reg::kControlPosition:
    case reg::kLowerBound:
    case reg::kUpperBound:
    case reg::kErrorPosition:
    case reg::kSetOutputNearest:
    case reg::kSetOutputExact:
      return position_rev;
    case reg::kVelocity:
    case reg::kControlVelocity:
    case reg::kErrorVelocity:
      return velocity_rev_s;
    case reg::kTorque:
    case reg::kControlTorque:
    case reg::kErrorTorque:
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
    case reg::kPwmInput + 1:
    case reg::kPwmInput + 3:
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

double largest(Quantity quantity, Format format) LITHE_RT {
  constexpr double kCounts[] = {127, 32767, 2147483647, std::numeric_limits<double>::infinity()};
  return kCounts[static_cast<std::size_t>(format)] * count_worth(quantity, format);
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

}  // namespace lithe::hal::moteus
